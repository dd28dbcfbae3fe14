# SPDX-License-Identifier: Apache-2.0
"""The measurement of hard scenes tells a pose that is a lie from one that is honest."""

from __future__ import annotations

import numpy as np
import pytest

from multilica.geometry import RigidTransform
from multilica.results import LidarPlacement
from multilica.simulate import RIGS, simulate_snapshot
from tests.bench.robustness import hard
from tests.bench.robustness.hard import CaseOutcome, Outcome, claims, figures, time_by_street
from tests.bench.robustness.random_rigs import RandomCase, _run, _with_axes
from tests.bench.support.cases import Case

_NOWHERE = Outcome(LidarPlacement("rear", "ambiguous"), "left")


def _lidar(status, off_m: float, sigma_m: float, off_rad: float = 0.0) -> Outcome:
    covariance = np.diag([1e-3, 1e-3, 1e-3, sigma_m, sigma_m, sigma_m]) ** 2
    placement = LidarPlacement("rear", "", status, RigidTransform.identity("left", "rear"), covariance=covariance)
    return Outcome(placement, "left", np.array([off_rad, 0.0, 0.0, off_m, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("lidar", "wrong", "beyond"),
    [
        (_lidar("placed", 0.01, 0.005), False, False),
        (_lidar("placed", 0.04, 0.005), False, True),
        (_lidar("placed", 0.06, 0.03), True, False),
        (_lidar("placed", 0.0, 0.03, off_rad=0.01), True, True),
        (_lidar("uncertain", 0.9, 0.3), False, False),
        (_lidar("uncertain", 20.0, 0.3), False, True),
        (_NOWHERE, False, False),
    ],
)
def test_a_lie_is_a_wrong_placement_or_one_beyond_its_bound(lidar: Outcome, wrong: bool, beyond: bool):
    assert (lidar.wrong, lidar.beyond) == (wrong, beyond)
    assert [claim.holds for claim in claims([lidar])] == [not wrong, not beyond]


def test_figures_count_each_lidar_once():
    case = Case("edgar", "motorway", 1)
    lidars = (_lidar("placed", 0.015, 0.01), _lidar("uncertain", 1.0, 0.2), _NOWHERE)
    counted = figures([CaseOutcome(case, 1, lidars, 2.0), CaseOutcome(case, 1, (_NOWHERE,), 4.0)])
    assert counted == [4, 1, 1, 2, 0, 1, "83.3%", "91.7%", "91.7%", "3.0", "4.0"]
    assert figures([CaseOutcome(case, 1, (_NOWHERE,), 2.0)])[6:9] == ["-", "-", "-"]


def test_a_scene_is_timed_by_streets_of_as_many_frames():
    times_s = {("tunnel", 1): (6.0, 10.0), ("street", 1): (4.0,), ("street", 10): (2.0,)}
    measured = [
        CaseOutcome(Case("edgar", scene, 1), frames, (), cpu_s)
        for (scene, frames), each in times_s.items()
        for cpu_s in each
    ]
    assert time_by_street(measured, "tunnel", 1) == 2.0
    assert time_by_street(measured, "tunnel", 10) == 0.0


def test_the_whole_run_has_600_lidars_and_all_flows(monkeypatch, capsys):
    asked = []
    monkeypatch.setattr(hard, "run_all", lambda _, tasks: asked.extend(tasks) or [])
    monkeypatch.setattr(hard, "figures", lambda found: [len(found)])
    assert hard.main()
    assert "| scene | frames |" in capsys.readouterr().out
    others = {"edgar": 3, "helipr": 3, "ring6": 5, "sides": 2, "truck": 6}
    assert sum(others[case.rig] for case, _ in asked if case.scene != hard.STREET) >= 600
    disturbances = {case.disturbances for case, _ in asked if case.scene == "motorway"}
    assert len(disturbances) == 4
    assert {case.disturbances for case, _ in asked if case.scene == "court"} == {()}


def test_a_random_vehicle_follows_from_its_seed():
    one, again, other = (RandomCase.of(seed) for seed in (5, 5, 6))
    assert one.rig.mounts == again.rig.mounts
    assert (one.scene, one.frames, one.disturbances) == (again.scene, again.frames, again.disturbances)
    assert one.rig.mounts != other.rig.mounts
    assert 2 <= len(one.rig.mounts) <= 5


def test_turned_frames_keep_the_vehicle():
    """Points lie at the same places of the vehicle, by the truth of turned frames."""
    made = simulate_snapshot("sides", "street", 3, frames=1)
    axes = {"left": np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])}
    turned = _with_axes(made, axes)
    for name in made.snapshot.names:
        before_m, after_m = (
            each.truth.T_target_source[name].apply(each.snapshot[name].points_m) for each in (made, turned)
        )
        np.testing.assert_allclose(after_m, before_m, atol=1e-4)
    assert np.array_equal(made.snapshot["left"].points_m, turned.snapshot["left"].points_m) is False
    assert sum(len(RandomCase.of(seed).axes) for seed in range(30)) > 5


@pytest.mark.in_turn
@pytest.mark.slow
def test_a_random_vehicle_is_calibrated_and_compared():
    outcome = _run(22)
    assert outcome is not None
    assert len(outcome.lidars) == len(RandomCase.of(22).rig.mounts) - 1
    assert "random" not in RIGS
