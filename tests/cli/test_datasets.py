# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from pathlib import Path

import pytest
import tomli_w

from multilica.extrinsics import extrinsics_table
from tests.cli.support import Invoke, assert_one_sentence
from tests.datasets.dataset_writers import write_helipr, write_opencalib


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data") / "0001"
    (folder.parent / "t.toml").write_text(tomli_w.dumps(extrinsics_table(write_opencalib(folder))))
    return folder


@pytest.mark.slow
@pytest.mark.in_turn
def test_tables_stand_beside_the_published_figures(scene: Path, invoke: Invoke) -> None:
    limits = ("--within-m", "0.05", "--within-deg", "0.5")
    truth = scene.parent / "t.toml"
    outcome = invoke("datasets", "opencalib", scene, "--preset", "default", "--truth", truth, "--out", "o", *limits)
    assert outcome.code == 0
    assert "snapshot 0001, preset default" in outcome.err
    lines = outcome.out.splitlines()
    assert lines[0] == "opencalib: 1 scene: 0001"
    rows = [line.split() for line in lines]
    assert ["default", "left", "1", "1", "(100%)", "1", "(100%)"] in [row[:7] for row in rows]
    assert ["published", "code,", "scene", "0001", "left", "1"] in [row[:6] for row in rows]
    assert any(line.startswith("published: The paper evaluates nothing on these scenes") for line in lines)
    assert any(line.startswith("default: ") and "s per scene" in line for line in lines)
    again = invoke("evaluate", "o/0001/default", "--truth", "o/0001/truth.toml", "--table", "paper", "--json", *limits)
    assert json.loads(again.out)["to_target"]["successes"] == 2


@pytest.mark.slow
@pytest.mark.nightly  # a push reads such a sequence in tests/datasets
def test_a_helipr_sequence_runs(tmp_path: Path, invoke: Invoke) -> None:
    sequence = write_helipr(tmp_path / "KAIST05")
    arguments = ("--preset", "default", "--scenes", "1", "--frames", "2", "--out", "o", "--quiet", "--json")
    outcome = invoke("datasets", "helipr", sequence, *arguments)
    assert (outcome.code, outcome.err) == (0, "")
    document = json.loads(outcome.out)
    (name,) = document["scenes"]
    table = document["presets"]["default"]["table"]
    assert [entry["lidar"] for entry in table["by_lidar"]] == ["Aeva", "Avia", "Velodyne"]
    assert {row["target"] for row in table["rows"]} == {"Ouster"}
    assert table["to_target"]["successes"] == 3
    assert Path(f"o/{name}/input.mcap").is_file()


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["kitti", "."], 2, "kitti"),
        (["helipr"], 2, "PATH"),
        (["helipr", "none"], 3, "No folder at none"),
        (["edgar", "none"], 3, "Nothing exists at none"),
        (["opencalib", "."], 3, "holds no scene"),
        (["opencalib", ".", "--scenes", "0"], 2, "Found 0 scenes"),
        (["opencalib", ".", "--preset", "papr"], 2, "no preset 'papr'"),
        (["opencalib", ".", "--topic", "left"], 2, "Cannot read --topic 'left'"),
        (["opencalib", ".", "--within-m", "-1"], 2, "limits above zero"),
    ],
)
def test_failures_are_one_sentence(arguments: list[str], code: int, words: str, invoke: Invoke) -> None:
    outcome = invoke("datasets", *arguments)
    assert_one_sentence(outcome, code)
    assert words in outcome.err
