# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest

from multilica.config import CalibrationConfig, known_keys, load_config, preset
from multilica_cli.commands.config import list_parameters
from multilica_cli.options import Parameters, inline_toml, sigma_limits, topic_names
from tests.cli.support import Invoke


def test_every_key_is_listed_once() -> None:
    assert sorted(parameter.key for parameter in list_parameters(CalibrationConfig())) == sorted(known_keys())


def test_every_parameter_says_what_it_means() -> None:
    assert [parameter.key for parameter in list_parameters(CalibrationConfig()) if not parameter.meaning] == []


def test_units_come_from_the_names() -> None:
    units = {parameter.key: parameter.unit for parameter in list_parameters(CalibrationConfig())}
    assert units["fine.voxel_size_m"] == "m"
    assert units["ground.max_tilt_deg"] == "deg"
    assert units["features.feature_radius_voxels"] == "voxels"
    assert units["fine.max_iterations"] == ""


@pytest.mark.parametrize("name", ["default", "paper"])
def test_the_printed_file_reads_back(name: str, invoke: Invoke) -> None:
    outcome = invoke("config", "--preset", name, "--toml")
    Path("printed.toml").write_text(outcome.out, encoding="utf-8")
    assert load_config(Path("printed.toml")) == preset(name)


def test_the_table_holds_every_key(invoke: Invoke) -> None:
    outcome = invoke("config")
    assert outcome.code == 0
    assert [key for key in known_keys() if key not in outcome.out] == []
    assert "\x1b" not in outcome.out


def test_settings_show_in_every_form(invoke: Invoke) -> None:
    settings = ("--preset", "paper", "--set", "fine.max_iterations=7")
    listed = json.loads(invoke("config", "--json", *settings).out)
    assert (
        next(entry["value"] for entry in listed if entry["name"] == "max_iterations" and entry["section"] == "fine")
        == 7
    )
    assert tomllib.loads(invoke("config", "--toml", *settings).out)["fine"]["max_iterations"] == 7


def test_sigma_limits_are_in_millimetres_and_degrees() -> None:
    limits = Parameters().resolve(sigma_limits("50, 0.5")).acceptance
    assert (limits.max_sigma_m, limits.max_sigma_deg) == (0.05, 0.5)
    assert Parameters().resolve(sigma_limits(None)) == preset("default")


def test_options_and_settings_override_the_preset() -> None:
    options = {"target": 'a "b"', "ingest.frames": 3, "ground.enabled": None, "ingest.topics": {"x.y": "/t/ö"}}
    config = Parameters("paper", None, ["ingest.frames=4"]).resolve(options)
    assert config.target == 'a "b"'
    assert config.ingest.frames == 4
    assert config.ingest.topics == {"x.y": "/t/ö"}
    assert config.ground.enabled is False
    assert config.preset == "paper"


def test_topic_texts_become_names() -> None:
    assert topic_names(["front=/a", "rear=/b=c"]) == {"front": "/a", "rear": "/b=c"}
    assert topic_names([]) is None


@pytest.mark.parametrize("value", [1, 1e-7, True, 'say "no"', "ö", [1.0, 2.5], {"a b": "/c"}, []])
def test_inline_toml_reads_back(value: object) -> None:
    assert tomllib.loads(f"value = {inline_toml(value)}") == {"value": value}
