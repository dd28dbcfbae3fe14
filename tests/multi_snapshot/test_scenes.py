# SPDX-License-Identifier: Apache-2.0
"""The same simulated vehicle in several scenes."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from multilica import events
from multilica.config import CalibrationConfig, with_overrides
from multilica.diagnosis import explain
from multilica.geometry import RigidTransform
from multilica.multi_snapshot import SnapshotRun, join, replay, shown_snapshot
from multilica.pipeline import calibrate
from multilica.results import Reason, Verdict
from multilica.simulate import simulate_snapshot
from multilica.sinks.report.contents import contents_of
from multilica.sinks.rerun.recording import RerunRecording
from multilica.sinks.rerun.scene import pair_path
from multilica.sinks.run_state import RunState
from multilica.snapshot import LidarScans, Scan, Snapshot
from tests.sinks.recording_reader import Recording, blueprint_names

pytestmark = pytest.mark.slow

_CONFIG = with_overrides(CalibrationConfig(), ["target=top", "fine.max_finalists=2"])
_LEVER_ARM_M = 10.0


@cache
def _simulated(scene):
    return simulate_snapshot("sides", scene, 41, frames=1, build_seed=7)


def _snapshot(scene, *, tampered=False):
    """Left and top, thinned; the points of left may be turned by 3 degrees."""
    points = {name: _simulated(scene).snapshot[name].scans[0].points_m[::2] for name in ("left", "top")}
    if tampered:
        points["left"] = RigidTransform.from_xyz_rpy("left", "left", [0, 0, 0], [0, 0, np.deg2rad(3)]).apply(
            points["left"]
        )
    lidars = tuple(LidarScans(name, (Scan(cloud.astype(np.float32)),)) for name, cloud in points.items())
    return Snapshot(lidars, scene, "c0ffee")


@cache
def _run(scene, *, tampered=False):
    snapshot = _snapshot(scene, tampered=tampered)
    name = f"{scene} tampered" if tampered else scene
    return SnapshotRun(name, calibrate(snapshot, _CONFIG), scene, snapshot.source_sha256)


def _error_m(result):
    truth = _simulated("garage").truth.between("top", "left")
    metres, radians = result["left"].T_target_source.distance_to(truth)
    return float(np.hypot(metres, _LEVER_ARM_M * radians))


@pytest.mark.in_turn
def test_two_scenes_are_no_worse_than_each_alone():
    runs = [_run("garage"), _run("parking")]
    joint = join(runs, _CONFIG)
    assert joint.status == "complete"
    alone = [_error_m(run.result) for run in runs]
    assert _error_m(joint) <= np.mean(alone)
    assert _error_m(joint) < 0.01
    assert joint["left"].spread.snapshots == 2
    assert [report.outliers for report in joint.snapshots] == [(), ()]


@pytest.mark.in_turn
def test_turned_lidar_is_outvoted_by_two_refused_by_one():
    bad = _run("parking", tampered=True)
    joint = join([_run("garage"), bad, _run("parking")], _CONFIG)
    assert joint.status == "complete"
    assert _error_m(joint) < 0.01
    named = {report.name: [*report.outliers] for report in joint.snapshots}
    assert named == {"garage": [], "parking tampered": ["left"], "parking": []}
    assert next(each.angle_deg for each in joint.snapshots[1].deviations if each.outlier) == pytest.approx(3.0, abs=0.1)
    refused = join([_run("garage"), bad], _CONFIG)
    assert refused.status == "failed"
    assert "garage and parking tampered place it" in refused["left"].reason


@pytest.mark.in_turn
def test_joint_result_is_replayed_with_its_best_snapshot(tmp_path):
    missing = replace(_run("garage").result, placements=(*_run("garage").result.placements, _placement("rear")))
    other = replace(_run("parking", tampered=True), source_sha256="beef")
    runs = [other, _run("garage"), replace(_run("parking"), result=missing)]
    config = with_overrides(_CONFIG, ["ground.enabled=true"])
    joint = join(runs, config)
    assert shown_snapshot(joint) == "garage"
    seen = []
    with RerunRecording(tmp_path / "joint.rrd") as record:
        told = replay(_snapshot("garage"), joint, config, lambda event: (record(event), seen.append(event)))
    assert {"Result", "Merged cloud", "Rig"} <= blueprint_names(tmp_path / "joint.rrd")[-1]
    first, last = seen[0], seen[-1]
    assert isinstance(first, events.CalibrationStarted)
    assert first.snapshot.names == ("left", "rear", "top")
    assert first.snapshot.source == "parking, garage, parking"
    assert len(first.snapshot.source_sha256) == 64
    assert last.result is told
    clouds = [event.cloud for event in seen if isinstance(event, events.CloudPreprocessed)]
    assert {cloud.lidar: len(cloud.points_m) > 0 for cloud in clouds} == {"left": True, "rear": False, "top": True}
    height_m = _simulated("garage").truth.T_target_source["top"].xyz_m[2]
    assert told.ground.offset_m == pytest.approx(height_m, abs=0.1)
    assert told.placements == joint.placements


@pytest.mark.in_turn
def test_joint_recording_and_report_show_the_decisive_pair(tmp_path):
    runs = [_refusing("garage"), _refusing("parking")]
    joint = join(runs, _CONFIG)
    assert joint.pairs == runs[0].result.pairs
    state = RunState()
    with RerunRecording(tmp_path / "joint.rrd") as record:
        replay(_snapshot("garage"), joint, _CONFIG, lambda event: (record(event), state(event)))
    assert "Not placed: left" in blueprint_names(tmp_path / "joint.rrd")[-1]
    shown = Recording(tmp_path / "joint.rrd").entity_paths
    assert pair_path(joint.pairs[0].target, joint.pairs[0].source, "scored", "source") in shown
    assert explain(state.document).missing[0].cause == "unexplained"
    scored = contents_of(state).scored[joint.pairs[0].target, joint.pairs[0].source]
    assert len(scored[0].points_m) > 100


def _refusing(scene):
    """A snapshot whose only pair was left undecided."""
    run = _run(scene)
    doubt = Verdict("undecided", (Reason("structure_unexplained", 0.3, 0.4, "30% are explained; expected 40%"),))
    pairs = tuple(replace(pair, verdict=doubt) for pair in run.result.pairs)
    placements = tuple(place if place.lidar == "top" else _placement(place.lidar) for place in run.result.placements)
    return replace(run, result=replace(run.result, pairs=pairs, trusted=(), placements=placements))


def _placement(lidar):
    return replace(
        _run("garage").result["left"], lidar=lidar, status="not_placed", T_target_source=None, reason="no returns"
    )
