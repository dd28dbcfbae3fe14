# SPDX-License-Identifier: Apache-2.0
from typing import get_args

import pytest
from pydantic import ValidationError

from multilica.config import (
    PRESETS,
    CalibrationConfig,
    FineConfig,
    known_keys,
    load_config,
    preset,
    with_overrides,
)
from multilica.config.loading import _USED_WITH
from multilica.errors import ConfigError, UnknownNameError


def _written(tmp_path, text):
    path = tmp_path / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_default_preset_is_the_default():
    assert preset("default") == CalibrationConfig()


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_knows_its_name(name):
    assert preset(name).preset == name


def test_the_paper_preset_is_what_the_paper_says():
    paper = preset("paper")
    assert paper.features.voxel_size_m == 0.35
    assert paper.features.orient_normals is False
    assert paper.coarse.max_hypotheses == 1
    assert paper.verify.enabled is False
    assert (paper.fine.engine, paper.fine.max_correspondence_distances_m) == ("open3d", (1.0,))
    assert (paper.merge.mode, paper.merge.fitness_threshold) == ("target_first", 0.2)


def test_the_presets_of_the_paper_differ_in_how_they_merge():
    algorithm1 = preset("paper-algorithm1")
    assert algorithm1.merge.mode == "algorithm1"
    assert algorithm1.model_copy(update={"preset": "paper", "merge": preset("paper").merge}) == preset("paper")


def test_an_unknown_preset_is_named_with_those_that_exist():
    with pytest.raises(
        UnknownNameError, match=r"no preset 'papr'; available: default, .*paper\b.*Did you mean 'paper'"
    ):
        preset("papr")


def test_a_file_overrides_its_preset(tmp_path):
    path = _written(tmp_path, 'preset = "paper"\ntarget = "top"\n[fine]\nmax_iterations = 7\n')
    config = load_config(path)
    assert (config.preset, config.target, config.fine.max_iterations) == ("paper", "top", 7)
    assert config.fine.model_copy(update={"max_iterations": 100}) == preset("paper").fine


def test_an_empty_file_is_the_default(tmp_path):
    path = _written(tmp_path, "")
    assert load_config(path) == load_config(str(path)) == CalibrationConfig()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[fine]\nmax_iteration = 3\n", r"no key 'fine\.max_iteration'\. Did you mean 'fine\.max_iterations'\?"),
        ("[fime]\nmax_iterations = 3\n", r"no key 'fime'"),
        ("[fine]\nmax_iterations = 0\n", r"fine\.max_iterations is 0: input should be greater than or equal to 1\."),
        ("[fine]\nmax_iterations = 2.5\n", r"fine\.max_iterations is 2\.5: "),
        ('[coarse]\nsolver = "magic"\n', r"coarse\.solver is 'magic': .*'cliques'"),
        ("fine = 3\n", r"fine is 3: expected a table of keys"),
        ("[fine]\nmax_correspondence_distances_m = []\n", r"fine\.max_correspondence_distances_m is \[\]"),
        ("[merge]\nfitness_threshold = 1.5\n", r"merge\.fitness_threshold is 1\.5"),
        ("[fine\n", "is not a readable TOML file"),
    ],
)
def test_what_is_wrong_in_a_file_is_named_with_the_file(tmp_path, text, message):
    path = _written(tmp_path, text)
    with pytest.raises(ConfigError, match=message) as caught:
        load_config(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_missing_a_folder_or_no_text(tmp_path):
    with pytest.raises(ConfigError, match=r"There is no configuration file at .*none\.toml"):
        load_config(tmp_path / "none.toml")
    with pytest.raises(ConfigError, match="is not a readable TOML file"):
        load_config(tmp_path)
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="is not a readable TOML file"):
        load_config(tmp_path / "binary.toml")


def test_an_unknown_preset_in_a_file(tmp_path):
    with pytest.raises(UnknownNameError, match="no preset 'mine'"):
        load_config(_written(tmp_path, 'preset = "mine"\n'))


@pytest.mark.parametrize(
    ("override", "read"),
    [
        ("fine.max_iterations=7", lambda it: it.fine.max_iterations == 7),
        (" fine.max_iterations = 7 ", lambda it: it.fine.max_iterations == 7),
        ("target=top", lambda it: it.target == "top"),
        ("drive.stops=auto", lambda it: it.drive.stops == "auto"),
        ('target="a=b"', lambda it: it.target == "a=b"),
        ("verify.enabled=false", lambda it: it.verify.enabled is False),
        (
            "fine.max_correspondence_distances_m=[1.0, 0.5]",
            lambda it: it.fine.max_correspondence_distances_m[0] == 1,
        ),
        ('ingest.topics={front = "/a"}', lambda it: it.ingest.topics == {"front": "/a"}),
    ],
)
def test_a_setting_is_read_as_toml_else_as_text(override, read):
    assert read(with_overrides(CalibrationConfig(), [override]))


def test_settings_apply_in_order_and_leave_the_original_alone():
    base = preset("paper")
    changed = with_overrides(base, ["fine.max_iterations=7", "fine.max_iterations=9", "runtime.seed=3"])
    assert (changed.fine.max_iterations, changed.runtime.seed) == (9, 3)
    assert base == preset("paper")


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("fine.max_iterations", "Cannot read the setting 'fine.max_iterations'; expected section.key=value"),
        ("=3", "Cannot read the setting '=3'"),
        ("fine.max_iterations=-1", r"setting 'fine\.max_iterations=-1', fine\.max_iterations is -1"),
        ("max_iterations=3", r"no key 'max_iterations'\. Did you mean '[a-z]+\.max_iterations'"),
        ("runtime.threads=2", r"no key 'runtime\.threads'\. Did you mean 'runtime\.workers'"),
        ("runtime.workers=many", r"runtime\.workers is 'many'"),
        ("until=lunch", r"until is 'lunch'"),
        ("drive.stops=0", r"drive\.stops is 0: expected auto, or a whole number from 1 on"),
    ],
)
def test_what_is_wrong_in_a_setting_is_named(override, message):
    with pytest.raises(ConfigError, match=message):
        with_overrides(CalibrationConfig(), [override])


def test_sections_cannot_be_changed_and_take_no_unknown_key():
    with pytest.raises(ValidationError, match="frozen"):
        CalibrationConfig().fine.max_iterations = 3
    with pytest.raises(ValidationError, match="Extra inputs"):
        FineConfig(max_iteration=3)


def test_every_key_is_known_once():
    keys = known_keys()
    assert {"target", "until", "preset", "fine.voxel_size_m"} <= set(keys)
    assert len(set(keys)) == len(keys)


@pytest.mark.parametrize(
    ("setting", "chooser"),
    [
        ("fine.rotation_epsilon_rad=1e-4", "fine.engine=open3d"),
        ("coarse.max_hypotheses=3", "coarse.solver=teaserpp"),
    ],
)
def test_a_setting_without_effect_is_refused(setting, chooser):
    key = setting.partition("=")[0]
    with pytest.raises(ConfigError, match=rf"setting '{setting}', {key} has no effect with {chooser}; leave it out"):
        with_overrides(preset("paper"), [setting])


def test_a_setting_cannot_choose_a_preset():
    told = (
        r"^The setting 'preset=paper' changes the name of the preset, not its values; choose one with --preset, in Pyt"
    )
    with pytest.raises(ConfigError, match=told):
        with_overrides(CalibrationConfig(), ["preset=paper"])


def test_two_points_have_no_normal():
    assert with_overrides(CalibrationConfig(), ["fine.neighbours=3"]).fine.neighbours == 3
    with pytest.raises(ConfigError, match=r"fine\.neighbours"):
        with_overrides(CalibrationConfig(), ["fine.neighbours=2"])


@pytest.mark.parametrize(
    "settings",
    [
        ("coarse.max_hypotheses=3", "coarse.solver=cliques"),
        ("fine.translation_epsilon_m=1e-3", "fine.engine=small_gicp"),
    ],
)
def test_a_setting_with_effect_is_taken_in_any_order(settings):
    assert with_overrides(preset("paper"), settings) != preset("paper")
    assert with_overrides(preset("paper"), settings[::-1]) == with_overrides(preset("paper"), settings)


def test_a_file_may_repeat_but_not_change_keys_without_effect(tmp_path):
    text = 'preset = "paper"\n[fine]\n'
    assert load_config(_written(tmp_path, f"{text}rotation_epsilon_rad = 1e-4\n")) == preset("paper")
    with pytest.raises(ConfigError, match=r"fine\.rotation_epsilon_rad has no effect with fine\.engine=open3d"):
        load_config(_written(tmp_path, f"{text}rotation_epsilon_rad = 1e-3\n"))


@pytest.mark.parametrize(
    "settings",
    [
        ("preprocess.min_range_m=200", "preprocess.max_range_m=300"),
        ("preprocess.max_range_m=0.5", "preprocess.min_range_m=0.2"),
    ],
)
def test_range_limits_leave_something_between(settings, tmp_path):
    assert with_overrides(preset("default"), settings) == with_overrides(preset("default"), settings[::-1])
    told = (
        r"preprocess\.min_range_m is \S+ and preprocess\.max_range_m \S+: no return lies between; set the first to less"
    )
    with pytest.raises(ConfigError, match=f"^{told}"):
        with_overrides(preset("default"), settings[:1])
    limits = settings[0].removeprefix("preprocess.")
    path = _written(tmp_path, f"[preprocess]\n{limits}\n")
    with pytest.raises(ConfigError, match=rf"^In {path}, {told}"):
        load_config(path)


def test_every_key_that_only_some_use_exists():
    for key, (chooser, user) in _USED_WITH.items():
        assert {key, chooser} <= {*known_keys()}
        section, name = chooser.split(".")
        allowed = get_args(type(getattr(CalibrationConfig(), section)).model_fields[name].annotation)
        assert user in allowed
