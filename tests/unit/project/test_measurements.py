# SPDX-License-Identifier: Apache-2.0
import dataclasses
import importlib
import json
import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica import read_extrinsics
from multilica.errors import UnfitSnapshotError
from multilica.geometry import RigidTransform
from multilica.results import LidarPlacement
from multilica.runs import PoseError
from multilica.runs.evaluation import Comparison
from multilica.runs.pose_error import as_sigma
from tests import opencalib
from tests.bench import __main__ as bench
from tests.bench import harder, peers, real_scans, repeat, scaling, simulated, speed
from tests.bench.robustness import soak
from tests.bench.support import cases
from tests.bench.support.cases import Case, LidarOutcome
from tests.bench.support.claims import Claim, print_claims
from tests.bench.support.process_cost import Cost, cost_of
from tests.bench.support.true_pose_check import Trial

_CASE = Case("sides", "garage", 1)
_STILL = RigidTransform.identity("top", "left")


def _lidar(outcome, *codes, normalised=1.0, trial=None, uncertain=False):
    error = None if outcome == "false_refuse" else PoseError.between(_STILL, _STILL)
    comparison = Comparison(
        run="run",
        truth="truth",
        target="top",
        lidar="left",
        placed=error is not None,
        uncertain=uncertain,
        outcome=outcome,
        error_normalised=None if error is None else normalised,
        error_sigma=None if error is None or normalised is None else as_sigma(normalised),
        reason="made",
        error=error,
    )
    return LidarOutcome(_CASE, comparison, codes, trial, uncertain)


_DOUBTFUL = _lidar("between", "not_observable", uncertain=True)
_GOOD, _WRONG = _lidar("within"), _lidar("false_accept", normalised=3.0)
_JUST = _lidar("false_refuse", "not_observable", trial=Trial(accepted=False, codes=("not_observable",)))
_MISSED = _lidar("false_refuse", "not_observable", trial=Trial(accepted=True, codes=()))


def test_every_measurement_can_be_run():
    for name in (*bench.MEASUREMENTS, *bench.ON_REQUEST):
        assert callable(importlib.import_module(bench.module_of(name)).main)


@pytest.mark.parametrize(("holds", "code"), [((True, True), 0), ((True, False), 1), ((False, True), 1)])
def test_the_exit_code_tells_whether_all_claims_hold(monkeypatch, capsys, holds, code):
    for name, answer in zip(("blind", "speed"), holds, strict=True):
        monkeypatch.setattr(f"tests.bench.{name}.main", lambda answer=answer: answer)
    assert bench.main(["blind", "speed"]) == code
    assert capsys.readouterr().out == "## blind\n\n## speed\n\n"


def test_an_unknown_measurement_is_named(capsys):
    assert bench.main(["sped"]) == 2
    assert "no measurement 'sped'; available: real_scans" in capsys.readouterr().err


def test_claims_are_printed_as_markdown(capsys):
    claims = [Claim("a", "0", "0", holds=True), Claim("b", "> 1", "1 | 2", holds=False)]
    assert not print_claims(claims)
    assert print_claims(claims[:1])
    lines = capsys.readouterr().out.splitlines()
    assert lines[:2] == ["| measure | expected | measured | holds |", "|---|---|---|---|"]
    assert lines[2:4] == ["| a | 0 | 0 | yes |", "| b | > 1 | 1 / 2 | no |"]


@pytest.mark.parametrize(
    ("lidars", "failing"),
    [
        ([_GOOD] * 97 + [_JUST] * 3, []),
        ([_GOOD] * 96 + [_JUST] * 4, ["placed within"]),
        ([_GOOD] * 99 + [_WRONG], ["placed, but"]),
        ([_GOOD] * 99 + [_MISSED], ["refused for"]),
        ([_GOOD] * 94 + [_lidar("within", normalised=2.0)] * 6, ["placed LiDARs within 3"]),
        ([_GOOD] * 94 + [_lidar("within", normalised=None)] * 6, ["placed LiDARs within 3"]),
        ([_lidar("within", normalised=0.4)] * 9, ["median normalised"]),
        ([_GOOD] * 97 + [_DOUBTFUL] * 3, []),
        ([_GOOD] * 98 + [_lidar("false_accept", normalised=2.0, uncertain=True)], ["uncertain"]),
    ],
)
def test_each_claim_on_simulated_rigs_can_fail(lidars, failing):
    claims = [claim for claim in simulated.claims(lidars, 0.97) if not claim.holds]
    assert len(claims) == len(failing)
    assert all(claim.measure.startswith(words) for claim, words in zip(claims, failing, strict=True))


def test_what_harder_scenes_let_expect():
    sliding = next(each for each in harder.EXPECTED if each.scene == "tunnel")
    placed = next(each for each in harder.EXPECTED if each.disturbance == "rain")
    either = next(each for each in harder.EXPECTED if each.disturbance == "low_overlap")
    other = _lidar("false_refuse", "structure_unexplained")
    assert [each.is_met(_DOUBTFUL) for each in (sliding, placed, either)] == [True, False, True]
    assert [each.is_met(_JUST) for each in (sliding, placed, either)] == [True, False, True]
    assert [each.is_met(_GOOD) for each in (sliding, placed, either)] == [False, True, True]
    assert not any(each.is_met(lidar) for each in (sliding, placed, either) for lidar in (_WRONG, _MISSED, other))
    shared_too_little = Trial(accepted=False, codes=("too_little_evidence",))
    contradicted = _lidar("false_refuse", "empty_space_violated", trial=shared_too_little)
    assert [each.is_met(contradicted) for each in (sliding, placed, either)] == [False, False, True]


@pytest.mark.slow
def test_a_snapshot_that_is_refused_speaks_against_the_verdict(monkeypatch):
    def refuse(*_):
        raise UnfitSnapshotError("The vehicle moves.")

    monkeypatch.setattr(cases, "calibrate", refuse)
    found = cases.run_case(_CASE, cases.CalibrationConfig())
    assert [(each.lidar, each.standing) for each in found] == [("right", "missed"), ("top", "missed")]


def test_an_input_with_other_bits_fails_the_claim():
    assert repeat.claim({"a": True, "b": True}).holds
    assert not repeat.claim({"a": True, "b": False}).holds


@pytest.mark.parametrize(("ours_s", "holds"), [((3.0, 9.0, 2.0), True), ((3.3, 9.0, 2.0), False)])
def test_the_median_ratio_of_times_is_compared(ours_s, holds):
    by_peer, by_paper = speed.claims("edgar", [speed.Lap(each_s, 3.0, 6.0) for each_s in ours_s])
    assert (by_peer.expected, by_paper.expected) == ("<= 1 x", "<= 0.5 x")
    assert by_peer.measured == f"{ours_s[0] / 3.0:.2f} x"
    assert (by_peer.holds, by_paper.holds) == (holds, ours_s[0] <= 3.0)


@pytest.mark.parametrize(
    ("case", "cost", "failing"),
    [
        (("sample", 2), Cost(10.0, 7.0, 100.0, ""), "wall of sample"),
        (("sectors20", 1), Cost(31.0, 10.0, 100.0, ""), "CPU of sectors20"),
        (("sectors20", 1), Cost(10.0, 10.0, 1001.0, ""), "memory of sectors20"),
        (("chain", 1), Cost(10.1, 10.0, 100.0, ""), "CPU of chain"),
    ],
)
def test_each_claim_on_costs_can_fail(case, cost, failing):
    names = ("sample", "edgar", "blind", "chain", "sectors8", "sectors20")
    runs = {(name, 1): [Cost(10.0, 10.0, 100.0, "")] * 3 for name in names}
    runs |= {(name, 2): [Cost(12.0, 6.0, 100.0, "")] * 3 for name in ("sample", "sectors8")}
    assert all(claim.holds for claim in scaling.claims(runs))
    [claim] = [claim for claim in scaling.claims(runs | {case: [cost] * 3}) if not claim.holds]
    assert claim.measure.startswith(failing)


@pytest.mark.parametrize("grown", ["memory_mb", "threads", "files"])
def test_what_grows_is_not_flat(grown):
    loading, steady = soak.Use(50.0, 1.0, 3.0), soak.Use(100.0, 4.0, 10.0)
    assert all(claim.holds for claim in soak.flat("made", [loading] * 10 + [steady] * 90))
    more = dataclasses.replace(steady, **{grown: 1.06 * getattr(steady, grown)})
    [claim] = [claim for claim in soak.flat("made", [loading] * 10 + [steady] * 80 + [more] * 10) if not claim.holds]
    assert grown in claim.measure


@pytest.mark.slow
def test_the_cost_includes_processes_that_outlive_the_command(tmp_path, monkeypatch):
    (tmp_path / "parent_of_orphan.py").write_text(
        "import subprocess, sys\n"
        "program = 'import time\\nwhile time.process_time() < 0.5: pass'\n"
        "subprocess.Popen([sys.executable, '-c', program], stdout=subprocess.DEVNULL)\n"
        "print('done')\n"
    )
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{Path(bench.__file__).parents[2]}")
    cost = cost_of("parent_of_orphan")
    assert cost.cpu_s > 0.5
    assert cost.output == "done\n"
    assert 1.0 < cost.memory_mb < 1000.0
    with pytest.raises(RuntimeError, match="ended with 1"):
        cost_of("no_such_module")


@pytest.mark.slow
@pytest.mark.in_turn
def test_the_peer_finds_poses():
    pytest.importorskip("kiss_matcher")
    recording = Path(bench.__file__).parents[2] / "recordings" / "samples" / "edgar-street.mcap"
    lines = cost_of(speed.PEER, recording, "left").output.splitlines()
    truth = read_extrinsics(recording.with_suffix(".truth.toml"))
    for line in lines:
        found = json.loads(line)
        pose = RigidTransform("left", found["lidar"], np.array(found["T_target_source"]))
        shift_m, turn_rad = pose.distance_to(truth.between("left", found["lidar"]))
        assert shift_m < 0.1
        assert turn_rad < np.deg2rad(1.0)
    assert len(lines) == 3


@pytest.mark.parametrize(
    ("y_m", "yaw_deg", "outcome"),
    [(0.01, 0.0, "right"), (0.04, 0.0, "beside"), (0.06, 0.0, "wrong"), (0.0, 0.45, "beside"), (0.0, 0.6, "wrong")],
)
def test_turned_scans_have_the_truth_of_the_original_ones(y_m, yaw_deg, outcome):
    rotation = Rotation.random(random_state=3).as_matrix()
    true = opencalib.TRUTH["left"]
    off = RigidTransform.from_xyz_rpy("top", "top", [0.0, 0.0, 0.0], [0.0, 0.0, np.deg2rad(yaw_deg)])
    pose = RigidTransform.from_rotation_translation(
        "top", "left", off.rotation @ true.rotation @ rotation.T, true.xyz_m + np.array([0.0, y_m, 0.0])
    )
    placement = LidarPlacement("left", "placed", "placed", T_target_source=pose)
    assert real_scans.judged(placement, rotation)[0] == outcome
    refused = LidarPlacement("left", "too little in common")
    assert real_scans.judged(refused, rotation) == ("refused", "too little in common")


def test_standings_of_a_system_are_counted():
    assert peers.row_of("kiss", ["right", "wrong", "refused", "wrong"]) == ("kiss", 4, 1, 0, 2, 0, 1)
