# SPDX-License-Identifier: Apache-2.0
"""Pairs in a recording."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from multilica import events
from multilica.results import BeamLabel, PairRegistration, Reason, Verdict
from multilica.sinks.rerun.recording import RerunRecording
from tests.sinks.made_events import LIDARS, TRUTH, made_events
from tests.sinks.recording_reader import Recording

PAIR = "/pairs/rear/top"


@pytest.fixture(scope="module")
def partial(recordings):
    return Recording(recordings["partial"])


def test_scored_points_are_logged_once_with_labels_per_pose(partial):
    for side in ("source", "target"):
        positions = partial.cells(f"{PAIR}/scored/{side}", "Points3D:positions")
        classes = partial.cells(f"{PAIR}/scored/{side}", "Points3D:class_ids")
        assert len(positions) == 1
        assert len(classes) == 4  # two hypotheses, scored roughly and finely
        assert all(len(cell) == len(positions[0][1]) for _, cell in classes)
        assert set(classes[0][1]) == {int(label) for label in BeamLabel}


def test_the_classes_have_names(partial):
    annotations = partial.rows("/pairs")[0]["AnnotationContext:context"][0]
    assert {entry["class_id"]: entry["class_description"]["info"]["label"] for entry in annotations} == {
        int(label): label.name.lower() for label in BeamLabel
    }


def test_a_pair_registered_the_other_way_round_keeps_its_sides(recordings):
    """The first pair is matched as `front left/1 <- rear`, registered as `rear <- front left/1`."""
    recording, path = Recording(recordings["complete"]), "/pairs/front\\ left\\/1/rear/scored"
    source, target = (len(recording.last(f"{path}/{side}", "Points3D:positions")) for side in ("source", "target"))
    classes = recording.cells(f"{path}/source", "Points3D:class_ids")
    assert {len(cell) for _, cell in classes} == {source}
    assert {len(cell) for _, cell in recording.cells(f"{path}/target", "Points3D:class_ids")} == {target}


def test_violations_are_at_the_pose(partial):
    """Every fourth probe violates, of the source and of the target."""
    found = np.asarray(partial.last(f"{PAIR}/scored/violations", "Points3D:positions"))
    probes = np.asarray(partial.cells(f"{PAIR}/scored/source", "Points3D:positions")[0][1])
    moved = (TRUTH["rear"].inverse() @ TRUTH["top"]).apply(probes[BeamLabel.VIOLATE :: 4])
    np.testing.assert_allclose(found[: len(moved)], moved, atol=1e-4)
    assert len(found) > len(moved)


def test_scores_show_graph_verdict_and_step_of_each_pose(partial):
    text = partial.last(f"{PAIR}/scores", "TextDocument:text")[0]
    assert "80 matches; consistency graph: 80 nodes, 200 edges; hypotheses: 2" in text
    assert text.startswith("# rear <- top\n\n**reject**\n- only 12 points")
    shown, other = re.findall(r"^\| ([^|]+) \| (\S+) \| \S+ \| (\S+) \| (\S+) \|", text, flags=re.MULTILINE)[2:]
    steps = [step for step, _ in partial.cells(f"{PAIR}/scored/source", "Points3D:class_ids")]
    assert shown == ("**clique 0**", f"**{steps[-1]}**", "**full**", "**90**")
    assert other == ("clique 1", str(steps[-2]), "full", "20")


def test_the_verdict_is_at_the_source(partial, recordings):
    assert partial.last(f"{PAIR}/verdict", "Points3D:labels") == ["rear <- top reject: too little evidence and 2 more"]
    assert partial.last(f"{PAIR}/verdict", "CoordinateFrame:frame") == ["pair/rear/top/0"]
    complete = Recording(recordings["complete"])
    assert complete.last(f"{PAIR}/verdict", "Points3D:labels") == ["rear <- top accept"]


def test_a_competing_pose_is_shown_only_where_it_is_a_reason(partial, recordings):
    assert partial.last(f"{PAIR}/competing", "CoordinateFrame:frame") == ["pair/rear/top/competing"]
    assert len(partial.last(f"{PAIR}/competing/fitting/source", "Points3D:positions"))
    translation = partial.last(f"{PAIR}/competing/pose", "Transform3D:translation")[0]
    truth_m = (TRUTH["rear"].inverse() @ TRUTH["top"]).xyz_m
    np.testing.assert_allclose(translation, truth_m * (-1.0, -1.0, 1.0), atol=1e-5)  # turned by 180 degrees
    assert f"{PAIR}/slide" in partial.entity_paths
    assert not {f"{PAIR}/competing", f"{PAIR}/slide"} & Recording(recordings["complete"]).entity_paths


def test_a_changed_verdict_repeats_no_progress(tmp_path):
    doubt = Verdict("undecided", (Reason("ambiguous", 1.0, 0.0, "another pair finds the scene alike"),))
    path = tmp_path / "doubted.rrd"
    with RerunRecording(path) as observe:
        for event in made_events():
            observe(event)
            match event:
                case events.PairRegistered(PairRegistration(target="rear", source="top") as found):
                    observe(events.VerdictChanged(replace(found, verdict=doubt)))
    recording = Recording(path)
    assert recording.last(f"{PAIR}/verdict", "Points3D:labels") == ["rear <- top undecided: another pose not ruled out"]
    assert f"{PAIR}/competing" not in recording.entity_paths
    assert len(recording.cells(f"{PAIR}/scored/source", "Points3D:class_ids")) == 4
    assert len(recording.cells("/gicp/fitness/rear/top/0", "Scalars:scalars")) == 4


def test_arrows_are_in_the_frame_of_the_registration(partial):
    path = "/pairs/front\\ left\\/1/rear/slide"
    assert partial.last(path, "CoordinateFrame:frame") == ["pair/front left/1/rear/0"]
    forth, back = np.array(partial.last(path, "Arrows3D:vectors"))
    np.testing.assert_allclose(forth, -back)
    assert forth[np.argmax(np.abs(forth))] > 0.0


def test_before_shows_the_hypothesis(recordings):
    recording = Recording(recordings["complete"])
    translation = recording.last(f"{PAIR}/before/pose", "Transform3D:translation")[0]
    np.testing.assert_allclose(translation, (TRUTH["rear"].inverse() @ TRUTH["top"]).xyz_m, atol=1e-5)
    assert recording.last(f"{PAIR}/before", "CoordinateFrame:frame") == ["pair/rear/top/before"]


def test_ellipsoids_are_three_sigma_and_enlarged(recordings):
    recording = Recording(recordings["complete"])
    sizes = recording.last("/lidars/rear/uncertainty", "Ellipsoids3D:half_sizes")[0]
    np.testing.assert_allclose(sorted(sizes), np.array([1e-3, 2e-3, 3e-3]) * 3.0 * 50.0, rtol=1e-5)
    summary = recording.last("/summary", "TextDocument:text")[0]
    assert "Ellipsoids of the rig: 3 sigma of the position, 50 times enlarged." in summary


def test_dropped_points_are_listed_with_their_reasons(partial):
    text = partial.last("/dropped", "TextDocument:text")[0]
    assert "| top | 1,200 | 4 | 9 | 1,200 | 600 |" in text
    assert "`too_near`: nearer than 1 m, such as the vehicle's own body (`preprocess.min_range_m`)" in text
    assert {f"| {name} |" for name in LIDARS} <= set(re.findall(r"^\| [^|]+ \|", text, flags=re.MULTILINE))


def test_a_refused_loop_may_join_a_pair_never_matched(tmp_path):
    path = tmp_path / "loop.rrd"
    with RerunRecording(path) as observe:
        for event in made_events():
            match event:
                case events.CorrespondencesMatched(each) if (each.target, each.source) == ("rear", "top"):
                    continue
                case events.HypothesesFound(each) if (each.target, each.source) == ("rear", "top"):
                    continue
                case events.HypothesesVerified(target="rear", source="top"):
                    continue
                case events.PairRegistered(PairRegistration(target="rear", source="top") as found):
                    observe(events.LoopRegistered(replace(found, verdict=Verdict("reject", found.verdict.reasons))))
                    continue
            observe(event)
    assert len(Recording(path).cells("/gicp/fitness/rear/top/0", "Scalars:scalars")) == 4
