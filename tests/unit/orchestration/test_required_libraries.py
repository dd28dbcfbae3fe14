# SPDX-License-Identifier: Apache-2.0
import pytest

from multilica.config import CalibrationConfig, PreprocessConfig, preset, with_overrides
from multilica.errors import ConfigError, MissingDependencyError
from multilica.orchestration import clouds
from multilica.orchestration.clouds import require_libraries
from multilica.pipeline import calibrate
from multilica.run import run_calibration
from tests.pipeline.watched import sides


@pytest.fixture
def without(monkeypatch):
    """Pretends that libraries are not installed."""

    def pretend(*modules):
        monkeypatch.setattr("multilica.optional_libraries.is_found", lambda module: module not in modules)

    return pretend


def _config(*overrides):
    return with_overrides(CalibrationConfig(), list(overrides))


def test_the_default_preset_needs_none(without):
    without("open3d", "networkx", "kiss_matcher", "teaserpp_python")
    require_libraries(CalibrationConfig())


@pytest.mark.parametrize(
    ("config", "module", "said"),
    [
        (_config("coarse.solver=kiss_matcher"), "kiss_matcher", "The solver 'kiss_matcher' needs the library"),
        (_config("coarse.solver=maximum_clique"), "networkx", "The solver 'maximum_clique' needs the library"),
        (_config("features.engine=open3d"), "open3d", "The engine 'open3d' of features needs the library"),
        (_config("fine.engine=open3d"), "open3d", "The engine 'open3d' of fine needs the library"),
        (preset("paper"), "open3d", "needs the library"),
    ],
    ids=["kiss", "clique", "features", "fine", "paper"],
)
def test_what_is_missing_is_told_with_the_command(without, config, module, said):
    require_libraries(config)
    without(module)
    with pytest.raises(MissingDependencyError, match=said) as error:
        require_libraries(config)
    assert "pip install" in str(error.value)


def test_a_stage_that_does_not_run_needs_nothing(without):
    without("open3d", "kiss_matcher")
    require_libraries(_config("until=preprocess", "features.engine=open3d", "coarse.solver=kiss_matcher"))
    require_libraries(_config("until=coarse", "fine.engine=open3d"))


def test_missing_system_libraries_are_told_with_their_command(monkeypatch):
    monkeypatch.setattr(clouds, "missing_for_open3d", lambda: ["libgl1"])
    monkeypatch.setattr("multilica.optional_libraries.missing_for_open3d", lambda: ["libgl1"])
    with pytest.raises(MissingDependencyError, match=r"apt-get install libgl1"):
        require_libraries(_config("fine.engine=open3d"))


def test_it_is_told_before_the_first_event(without):
    without("kiss_matcher")
    seen = []
    with pytest.raises(MissingDependencyError):
        calibrate(sides().snapshot, _config("coarse.solver=kiss_matcher"), seen.append)
    assert seen == []


def test_range_limits_given_in_python_are_checked_first(tmp_path):
    config = CalibrationConfig(preprocess=PreprocessConfig(min_range_m=100.0, max_range_m=100.0))
    for run in (lambda: calibrate(sides(), config), lambda: run_calibration(tmp_path, tmp_path / "out", config)):
        with pytest.raises(ConfigError, match="no return lies between"):
            run()
