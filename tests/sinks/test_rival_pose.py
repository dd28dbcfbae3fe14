# SPDX-License-Identifier: Apache-2.0
"""Which pose is drawn beside the chosen one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from multilica import events, testimony
from multilica.config import CalibrationConfig
from multilica.geometry import RigidTransform
from multilica.results import Assessment, PairRegistration, PreprocessedCloud, Reason, Verdict
from multilica.sinks.report.contents import contents_of
from multilica.sinks.report.figures import pair_figures
from multilica.sinks.rival_pose import rival_of
from multilica.sinks.run_story import RunStory
from multilica.snapshot import LidarScans, Scan, Snapshot
from tests.sinks.made_events import made_events

TURN = RigidTransform.from_xyz_rpy("hall", "hall", (0.0, 0.0, 0.0), (0.0, 0.0, np.pi))
"""What the hall looks the same after, with the first LiDAR in its middle."""
DOUBT = Verdict("undecided", (Reason("ambiguous", 1.0, 0.0, "hall and roof find the scene alike"),))


def wall(distance_m: float) -> np.ndarray:
    """A wall across x, as a scanner of half a degree sees it."""
    angles = np.deg2rad(np.mgrid[-30:30.5:0.5, -10:10.5:0.5].reshape(2, -1))
    return distance_m * np.column_stack([np.ones(angles.shape[1]), np.tan(angles[0]), np.tan(angles[1])])


def pair(pose: RigidTransform, rivals: tuple[RigidTransform, ...] = (), verdict: Verdict = DOUBT) -> PairRegistration:
    beams = testimony.Testimony(1000, 0, 0, 0, np.diag([50.0, 200, 200, 200, 200, 400]), np.zeros(0, np.uint8))
    finalists = tuple(Assessment(0, one, beams, 0.8, 0.03, 5.0, np.zeros((0, 3))) for one in (pose, *rivals))
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
        assessments=finalists,
        verdict=verdict,
    )


@pytest.fixture
def hall() -> RunStory:
    """`hall` and `back` look apart at the ends of a hall; `roof` sees all of it, so two poses."""
    seen = RigidTransform.from_xyz_rpy("hall", "roof", (0.0, 0.0, 0.5), (0.0, 0.0, 0.0))
    apart = RigidTransform.from_xyz_rpy("hall", "back", (0.0, 0.0, 0.0), (0.0, 0.0, np.pi))
    lidars = {name: wall(10.0) for name in ("back", "hall", "roof")}
    scans = tuple(LidarScans(name, (Scan(points.astype(np.float32)),)) for name, points in lidars.items())
    story = RunStory()
    story(events.CalibrationStarted(Snapshot(scans), CalibrationConfig()))
    for name, points in lidars.items():
        story(events.CloudPreprocessed(PreprocessedCloud(name, points, points)))
    story(events.StageStarted("fine", 0))
    story(events.PairRegistered(pair(seen, (TURN @ seen,), Verdict("undecided"))))
    story(events.PairRegistered(pair(apart)))
    return story


def test_a_symmetry_that_another_pair_sees_gives_the_other_pose_with_what_beams_say_of_it(hall):
    rival = rival_of(hall, hall.registrations["hall", "back"])
    expected = RigidTransform.identity("hall", "back")
    assert rival.T_target_source.distance_to(expected) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert rival.testimony.agree > 300
    assert len(rival.probes_m) == len(rival.testimony.labels)


def test_the_report_draws_both_poses(hall):
    contents = contents_of(hall)
    chosen, other = contents.judged["hall", "back"]
    assert chosen.T_target_source.rpy_deg[2] == pytest.approx(180.0)
    assert other.T_target_source.rpy_deg[2] == pytest.approx(0.0)
    level = RigidTransform.identity("level", "hall")
    figures = pair_figures(contents, ("hall", "back"), level, dict.fromkeys(hall.lidars, (200, 100, 50)))
    assert [figure.caption.split(",")[0] for figure in figures] == [
        "back on hall at the best pose that was found",
        "back on hall at another pose that is about as good",
    ]


def test_two_lidars_that_see_nothing_of_each_other_have_a_picture_that_says_so(hall):
    contents = contents_of(hall)
    chosen = replace(contents.judged["hall", "back"][0], labels=np.zeros(0, np.uint8), points_m=np.zeros((0, 3)))
    unseen = replace(chosen, labels=np.zeros(5, np.uint8), points_m=wall(10.0)[:5])
    contents = replace(contents, judged={("hall", "back"): (chosen, unseen)})
    level = RigidTransform.identity("level", "hall")
    figures = pair_figures(contents, ("hall", "back"), level, dict.fromkeys(hall.lidars, (200, 100, 50)))
    assert figures[0].caption.endswith("each in its colour.")
    assert figures[1].caption.endswith("no point of one lies in view of the other, so nothing speaks against it.")


def test_where_no_other_pair_sees_a_symmetry_there_is_no_other_pose(hall):
    del hall.registrations["hall", "roof"]
    assert rival_of(hall, hall.registrations["hall", "back"]) is None


def test_a_pose_of_the_pairs_own_is_the_rival_whose_share_the_verdict_names():
    story = RunStory()
    for event in made_events("partial"):
        story(event)
    refused = story.registrations["rear", "top"]
    assert rival_of(story, refused) is refused.assessments[1]
    assert rival_of(story, replace(refused, verdict=Verdict("accept"))) is None


def test_a_loop_that_did_not_close_leaves_the_pair_as_it_was(hall):
    before = hall.registrations["hall", "back"]
    hall(events.StageStarted("refine", 0))
    hall(events.PairRegistered(replace(before, verdict=Verdict("reject", DOUBT.reasons))))
    assert hall.registrations["hall", "back"] is before
    closed = replace(before, verdict=Verdict("accept"))
    hall(events.PairRegistered(closed))
    assert hall.registrations["hall", "back"] is closed
