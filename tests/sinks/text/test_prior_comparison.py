# SPDX-License-Identifier: Apache-2.0
"""Outputs of a run with a prior."""

from __future__ import annotations

import json
import re

import jsonschema
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica import events
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.results import PRIOR, CalibrationResult, CoarseResult, LidarPlacement
from multilica.results.building import provenance_of, result_document, surprises
from multilica.sinks.run_state import RunState
from multilica.sinks.text.log_lines import log_lines
from multilica.sinks.text.markdown import hypotheses_markdown, summary_markdown
from tests.sinks.conftest import record
from tests.sinks.files.test_result_files import SCHEMA
from tests.sinks.made_events import TARGET, TRUTH, UNPLACED, made_events
from tests.sinks.recording_reader import Recording

BACKWARDS, AS_DRAWN = "front left/1", "rear"


def off(name: str, xyz_m=(0.0, 0.0, 0.0), rpy_deg=(0.0, 0.0, 0.0)) -> RigidTransform:
    return TRUTH[name] @ RigidTransform.from_xyz_rpy(name, name, xyz_m, np.deg2rad(rpy_deg).tolist())


CLAIM = Extrinsics(
    TARGET, {BACKWARDS: off(BACKWARDS, rpy_deg=(0, 0, 180)), AS_DRAWN: off(AS_DRAWN, (0.1, 0.0, 0.0), (0, 2, 0))}
)


def told(*args: str) -> list[events.Event]:
    return list(made_events(*args, prior=CLAIM))


def lines_of(kind: type, *args: str) -> list[str]:
    return [line.text for event in told(*args) if isinstance(event, kind) for line in log_lines(event)]


def surprised_by(claimed: RigidTransform, name: str = BACKWARDS) -> tuple[str, ...]:
    placement = LidarPlacement(name, "placed", "placed", T_target_source=TRUTH[name], T_target_source_prior=claimed)
    return surprises(CalibrationResult(TARGET, "as asked for", (placement,)))


@pytest.mark.parametrize(
    ("xyz_m", "rpy_deg", "said"),
    [
        ((0, 0, 0), (0, 0, 180), "is turned by 180 deg about its z axis against its prior: "),
        ((0, 0, 0), (0, 0, 180), "is mounted backwards, or the prior is wrong."),
        ((0, 0, 0), (5, 0, -170), "is mounted backwards, or the prior is wrong."),
        ((0, 0, 0), (180, 0, 0), "about its x axis against its prior: .* is mounted upside down"),
        (
            (0, 0, 0),
            (0, 90, 0),
            "turned by 90 deg about its y .*: the pose of front left/1 or top differs from the prior",
        ),
        ((0, 0, 0), (120, 0, 120), r"is turned by \d+ deg against its prior: "),
        ((0.2, 0.3, 0), (0, 3, 0), "turned by 3 deg about its y axis against its prior and 0.36 m away from it: "),
        ((0.2, 0.3, 0), (0, 0, 0), "is 0.36 m away from its prior: "),
    ],
)
def test_a_large_difference_is_described_with_its_cause(xyz_m, rpy_deg, said):
    (text,) = surprised_by(off(BACKWARDS, xyz_m, rpy_deg))
    assert text.startswith(f"{BACKWARDS} is ")
    assert re.search(said, text)


def _rig(claimed: dict[str, RigidTransform], found: dict[str, RigidTransform]) -> tuple[LidarPlacement, ...]:
    return tuple(
        LidarPlacement(name, "placed", "placed", T_target_source=found[name], T_target_source_prior=claimed[name])
        for name in sorted(found)
    )


MOUNTS = {
    "front": RigidTransform.from_xyz_rpy("top", "front", (2.0, 0.1, -0.4), (0.0, 0.1, 0.0)),
    "left": RigidTransform.from_xyz_rpy("top", "left", (0.2, 0.9, -0.4), (0.0, 0.0, 1.6)),
    "rear": RigidTransform.from_xyz_rpy("top", "rear", (-2.1, -0.1, -0.5), (0.05, 0.0, 3.1)),
    "top": RigidTransform.identity("top", "top"),
}


def _exchange(one: str, other: str) -> dict[str, RigidTransform]:
    """What is found where the recording has exchanged two names, relative to what is then called top."""
    named = {name: name for name in MOUNTS} | {one: other, other: one}
    from_top = MOUNTS[named["top"]].matrix
    return {name: RigidTransform("top", name, np.linalg.solve(from_top, MOUNTS[named[name]].matrix)) for name in MOUNTS}


@pytest.mark.parametrize("names", [("front", "rear"), ("left", "rear"), ("front", "top"), ("rear", "top")])
def test_exchanged_names_are_told(names):
    result = CalibrationResult("top", "as asked for", _rig(MOUNTS, _exchange(*names)))
    texts = surprises(result)
    assert texts
    assert all(f"{names[0]} and {names[1]} have exchanged names" in text for text in texts)


def test_a_moved_mount_exchanges_no_names():
    assert surprises(CalibrationResult("top", "as asked for", _rig(MOUNTS, MOUNTS))) == ()
    moved = MOUNTS | {"rear": RigidTransform.from_xyz_rpy("top", "rear", (-1.0, 0.4, -0.5), (0.05, 0.0, 3.1))}
    (text,) = surprises(CalibrationResult("top", "as asked for", _rig(MOUNTS, moved)))
    assert "exchanged" not in text


@pytest.mark.parametrize("angle_deg", [0.0, 1e-15, 1e-9, 0.49])
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, -1), (1, 1, 0)])
def test_no_axis_is_named_for_a_rotation_of_zero(angle_deg, axis):
    turned = np.eye(4)
    turned[:3, :3] = Rotation.from_rotvec(angle_deg * np.array(axis) / np.linalg.norm(axis), degrees=True).as_matrix()
    turned[:3, 3] = 0.0, 0.0, 1.0
    (text,) = surprised_by(TRUTH[BACKWARDS] @ RigidTransform(BACKWARDS, BACKWARDS, turned))
    assert (
        text
        == f"{BACKWARDS} is 1.00 m away from its prior: the pose of {BACKWARDS} or {TARGET} differs from the prior."
    )


@pytest.mark.parametrize(
    ("xyz_m", "rpy_deg"), [((0, 0, 0), (0, 0, 0)), ((0.29, 0, 0), (0, 0, 0)), ((0, 0, 0), (9, 0, 0))]
)
def test_a_small_difference_is_not_described(xyz_m, rpy_deg):
    assert surprised_by(off(BACKWARDS, xyz_m, rpy_deg)) == ()


def test_the_log_names_the_prior_and_the_surprise():
    assert "the prior has front left/1, rear, top" in lines_of(events.CalibrationStarted)
    assert all("2 hypotheses, 20 of 80" in text for text in lines_of(events.HypothesesFound))
    assert all(text.endswith("; 3 agree with the prior") for text in lines_of(events.HypothesesFound))
    assert len(lines_of(events.PairRegistered)) == 3
    assert all(" from the prior: " in text for text in lines_of(events.PairRegistered))
    (merged,) = lines_of(events.GroupsRegistered)
    assert " from the merged pose: " in merged
    last = [line for line in log_lines(told()[-1]) if line.level == "WARN"]
    assert [line.text.split(" against ")[0] for line in last] == ["front left/1 is turned by 180 deg about its z axis"]


def test_the_log_names_the_pose_with_the_most_evidence():
    event = next(event for event in told() if isinstance(event, events.HypothesesVerified))
    prior = next(one for one in event.registrations if one.origin == PRIOR)
    (line,) = log_lines(events.HypothesesVerified(event.target, event.source, (prior,)))
    assert "the prior has the most evidence" in line.text
    assert "clique 0 has the most evidence" in log_lines(event)[0].text


def test_a_prior_alone_is_no_pose_that_the_matches_agree_on():
    event = next(event for event in told() if isinstance(event, events.HypothesesFound))
    coarse = CoarseResult("a", "b", event.coarse.hypotheses[-1:])
    (line,) = log_lines(events.HypothesesFound(coarse, event.correspondences))
    assert (line.level, line.text) == ("WARN", "a <- b: no hypothesis from 80 matches; 3 agree with the prior")


def test_the_summary_names_the_prior_and_the_surprise():
    state = RunState()
    for event in told():
        state(event)
    summary = summary_markdown(state)
    assert "- **Warning**: front left/1 is turned by 180 deg about its z axis against its prior" in summary
    rows = [line for line in hypotheses_markdown(state).splitlines() if line.startswith("| rear <- top |")]
    assert [row.split(" | ")[1] for row in rows] == ["clique 0", "clique 1", "the prior"]
    assert "accept" in rows[2]
    assert "accept" not in rows[0]


def test_the_table_has_the_prior_however_little_it_is_believed():
    state = RunState()
    for event in told():
        state(event)
    pair = ("rear", "top")
    best, other, prior = state.verified[pair]
    state.verified[pair] = (best, other, other, prior)
    rows = [line for line in hypotheses_markdown(state).splitlines() if line.startswith("| rear <- top |")]
    assert [row.split(" | ")[1:4] for row in rows][2:] == [["the prior", "3", f"{prior.visibility.agree}"]]


@pytest.mark.parametrize("outcome", ["complete", "partial"])
def test_result_json_holds_each_prior_with_the_deviation(outcome):
    first, *_, last = told(outcome)
    document = result_document(last.result, first.config, provenance_of(first.snapshot))
    document = json.loads(document.model_dump_json())
    jsonschema.validate(document, SCHEMA)
    priors = {name: lidar["prior"] for name, lidar in document["lidars"].items()}
    claimed = CLAIM.between(TARGET, BACKWARDS)
    np.testing.assert_array_equal(priors[BACKWARDS]["T_target_source"], claimed.matrix)
    assert priors[BACKWARDS]["deviation_deg"] == pytest.approx(180.0)
    assert (priors[TARGET]["deviation_m"], priors[TARGET]["deviation_deg"]) == pytest.approx((0.0, 0.0), abs=1e-9)
    expected = (0.1, 2.0) if outcome == "complete" else (None, None)
    assert (priors[UNPLACED]["deviation_m"], priors[UNPLACED]["deviation_deg"]) == pytest.approx(expected)
    assert {pair["registrations"][0]["origin"] for pair in document["pairs"]} == {PRIOR}


def test_without_a_prior_result_json_says_null():
    first, *_, last = made_events()
    document = result_document(last.result, first.config, provenance_of(first.snapshot))
    assert [lidar.prior for lidar in document.lidars.values()] == [None] * 3


def test_the_recording_calls_its_poses_prior(tmp_path):
    recording = Recording(record(tmp_path / "prior.rrd", prior=CLAIM))
    poses = {path for path in recording.entity_paths if path.startswith("/pairs/rear/top/poses/")}
    assert poses == {f"/pairs/rear/top/poses/{pose}" for pose in ("0", "1", "prior", "merged-1")}
    frames = [cell[0] for _, cell in recording.cells("/pairs/rear/top/source", "CoordinateFrame:frame")]
    assert frames[-1] == "pair/rear/top/prior"
    translation = recording.last("/pairs/rear/top/poses/prior", "Transform3D:translation")[0]
    np.testing.assert_allclose(translation, (TRUTH["rear"].inverse() @ TRUTH["top"]).xyz_m, atol=1e-5)
    assert "/gicp/fitness/rear/top/prior" in recording.entity_paths
    assert any("front left/1 is turned by 180 deg" in text for _, level, text in recording.log if level == "WARN")
