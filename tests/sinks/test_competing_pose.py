# SPDX-License-Identifier: Apache-2.0
"""Competing poses in the sinks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from multilica import events
from multilica.acceptance.rig import check_scene_symmetry
from multilica.config import AcceptanceConfig, CalibrationConfig
from multilica.geometry import RigidTransform
from multilica.results import BeamLabel, PairRegistration, PreprocessedCloud, Reason, Registration, Verdict
from multilica.results import visibility_score as visibility
from multilica.sinks.report import figures as report_figures
from multilica.sinks.report.contents import contents_of
from multilica.sinks.report.figures import pair_figures
from multilica.sinks.run_state import RunState
from multilica.snapshot import LidarScans, Scan, Snapshot
from multilica.visibility.sensor_view import ROUGH_TOLERANCES, prepare_sensor_view, score_pose
from tests.sinks.made_events import made_events

TURN = RigidTransform.from_xyz_rpy("hall", "hall", (0.0, 0.0, 0.0), (0.0, 0.0, np.pi))
"""Rotation that maps the hall to itself, with the first LiDAR in its middle."""
DOUBT = Verdict("undecided", (Reason("ambiguous", 1.0, 0.0, "hall and roof find the scene alike"),))


def wall(distance_m: float) -> np.ndarray:
    """A wall across x, as a scanner of half a degree sees it."""
    angles = np.deg2rad(np.mgrid[-30:30.5:0.5, -10:10.5:0.5].reshape(2, -1))
    return distance_m * np.column_stack([np.ones(angles.shape[1]), np.tan(angles[0]), np.tan(angles[1])])


def pair(
    pose: RigidTransform, competing_poses: tuple[RigidTransform, ...] = (), verdict: Verdict = DOUBT
) -> PairRegistration:
    beams = visibility.VisibilityScore(1000, 0, 0, 0, np.diag([50.0, 200, 200, 200, 200, 400]), np.zeros(0, np.uint8))
    registrations = tuple(
        Registration(0, one, beams, 0.8, 0.03, 5.0, np.zeros((0, 3))) for one in (pose, *competing_poses)
    )
    return PairRegistration(
        pose.target,
        pose.source,
        pose,
        0.9,
        0.1,
        10,
        converged=True,
        iterations=3,
        engine="test",
        registrations=registrations,
        verdict=verdict,
    )


@pytest.fixture
def hall() -> RunState:
    """`hall` and `back` look apart at the ends of a hall; `roof` sees all of it, so two poses."""
    seen = RigidTransform.from_xyz_rpy("hall", "roof", (0.0, 0.0, 0.5), (0.0, 0.0, 0.0))
    apart = RigidTransform.from_xyz_rpy("hall", "back", (0.0, 0.0, 0.0), (0.0, 0.0, np.pi))
    lidars = {name: wall(10.0) for name in ("back", "hall", "roof")}
    scans = tuple(LidarScans(name, (Scan(points.astype(np.float32)),)) for name, points in lidars.items())
    state = RunState()
    state(events.CalibrationStarted(Snapshot(scans), CalibrationConfig()))
    for name, points in lidars.items():
        state(events.CloudPreprocessed(PreprocessedCloud(name, points, points)))
    state(events.StageStarted("fine", 0))
    views = {name: prepare_sensor_view(cloud) for name, cloud in state.clouds.items()}
    pairs = [pair(seen, (TURN @ seen,), Verdict("undecided")), pair(apart, verdict=Verdict("accept"))]

    def score(pose: RigidTransform) -> Registration:
        return score_pose(views[pose.target], views[pose.source], pose, *ROUGH_TOLERANCES)

    for found in check_scene_symmetry(pairs, score, AcceptanceConfig()):
        state(events.PairRegistered(found))
    return state


def test_a_symmetry_of_another_pair_gives_the_competing_pose(hall):
    competing_pose = hall.competing(("hall", "back"))
    expected = RigidTransform.identity("hall", "back")
    assert competing_pose.T_target_source.distance_to(expected) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert competing_pose.visibility.agree > 300
    assert len(competing_pose.probes_m) == len(competing_pose.visibility.labels)


def test_the_report_draws_both_poses(hall):
    contents = contents_of(hall)
    chosen, other = contents.scored["hall", "back"]
    assert chosen.T_target_source.rpy_deg[2] == pytest.approx(180.0)
    assert other.T_target_source.rpy_deg[2] == pytest.approx(0.0)
    figures = pair_figures(contents, ("hall", "back"))
    assert [figure.caption.split(",")[0] for figure in figures] == [
        "back on hall at the best pose",
        "back on hall at a competing pose that other pairs imply",
    ]
    assert f"{other.agree:,} points agree" in figures[1].caption
    labels = np.concatenate([other.labels, other.target_labels])
    assert np.count_nonzero(labels == BeamLabel.AGREE) == other.agree > 0


@pytest.mark.parametrize(("rank", "words"), [(1, "the next best pose"), (2, "the competing pose")])
def test_only_the_second_pose_by_evidence_is_the_next_best(hall, monkeypatch, rank, words):
    contents = contents_of(hall)
    chosen, other = (each.T_target_source for each in contents.scored["hall", "back"])
    ranked = [chosen, RigidTransform.from_xyz_rpy("hall", "back", (9.0, 0.0, 0.0), (0.0, 0.0, 0.0))]
    ranked.insert(rank, other)
    monkeypatch.setattr(report_figures, "finalists", lambda _: ranked)
    drawn = pair_figures(contents, ("hall", "back"))
    assert drawn[1].caption.startswith(f"back on hall at {words}, from above")


def test_the_picture_of_lidars_without_common_view_says_so(hall):
    contents = contents_of(hall)
    none, nothing = np.zeros(0, np.uint8), np.zeros((0, 3))
    chosen = replace(
        contents.scored["hall", "back"][0], labels=none, points_m=nothing, target_labels=none, target_points_m=nothing
    )
    unseen = replace(chosen, labels=np.zeros(5, np.uint8), points_m=wall(10.0)[:5])
    contents = replace(contents, scored={("hall", "back"): (chosen, unseen)})
    figures = pair_figures(contents, ("hall", "back"))
    assert figures[0].caption.endswith("each in its colour.")
    assert figures[1].caption.endswith("neither LiDAR sees a point of the other, so nothing contradicts this pose.")


def test_a_competing_pose_of_the_pair_itself_is_drawn():
    state = RunState()
    for event in made_events("partial"):
        state(event)
    refused = state.registrations["rear", "top"]
    assert state.competing(("rear", "top")) is refused.registrations[1]
    state(events.VerdictChanged(replace(refused, verdict=Verdict("accept"))))
    assert state.competing(("rear", "top")) is None


def test_a_loop_that_did_not_close_leaves_the_pair_as_it_was(hall):
    before = hall.registrations["hall", "back"]
    hall(events.LoopRegistered(replace(before, verdict=Verdict("reject", DOUBT.reasons))))
    assert hall.registrations["hall", "back"] is before
    closed = replace(before, verdict=Verdict("accept"))
    hall(events.LoopRegistered(closed))
    assert hall.registrations["hall", "back"] is closed
