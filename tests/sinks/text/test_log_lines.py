# SPDX-License-Identifier: Apache-2.0
"""Log lines and summaries of made-up runs."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from multilica import events
from multilica.results import CoarseResult, MergeCandidate, MergeDecision, SnapshotReport
from multilica.sinks.run_state import RunState
from multilica.sinks.text.log_lines import log_lines, pair_label
from multilica.sinks.text.markdown import candidate_label, decisions_markdown, hypotheses_markdown, summary_markdown
from tests.sinks.made_events import LIDARS, UNPLACED, made_events


def state_of(*args, stop_after: int | None = None) -> RunState:
    state = RunState()
    for event in list(made_events(*args))[:stop_after]:
        state(event)
    return state


def test_points_on_objects_that_moved_are_told():
    (line,) = log_lines(events.MovableFound("rear", np.zeros((12, 3)), 600, moved=True))
    assert (line.level, line.text) == ("INFO", "rear: 12 of 600 points on objects that moved, left out")


def test_every_event_has_a_line():
    assert all(log_lines(event) for event in made_events("partial"))


@pytest.mark.parametrize(("outcome", "level"), [("complete", "INFO"), ("partial", "WARN"), ("failed", "WARN")])
def test_the_last_line_is_the_outcome(outcome, level):
    *_, last = made_events(outcome)
    line = log_lines(last)[-1]
    assert line.level == level
    assert line.text.startswith(f"calibration {outcome}: ")


def test_each_lidar_that_is_missing_is_an_error_with_its_reason():
    *_, last = made_events("failed")
    errors = [line.text for line in log_lines(last) if line.level == "ERROR"]
    assert [text.split(" is not placed: ")[0] for text in errors] == ["front left/1", "rear"]


def test_a_pair_that_is_not_accepted_is_a_warning():
    lines = [log_lines(event)[0] for event in made_events("partial") if isinstance(event, events.PairRegistered)]
    doubted = [line for line in lines if line.level == "WARN"]
    assert all("reject: only 12 points lie on walls (evidence 1.2, limit 2.3)" in line.text for line in doubted)
    assert [UNPLACED in line.text for line in lines] == [line.level == "WARN" for line in lines]


def test_a_pair_without_points_in_common_has_no_rmse():
    event = next(event for event in made_events() if isinstance(event, events.PairRegistered))
    apart = replace(event.registration, fitness=0.0, rmse_m=math.inf, inliers=0)
    (line,) = log_lines(events.PairRegistered(apart))
    assert "no points in common after" in line.text
    assert "inf" not in line.text
    state = state_of()
    state(events.PairRegistered(apart))
    candidate = MergeCandidate(apart.target, apart.source, 0.0, math.inf, passes=False)
    shown = hypotheses_markdown(state) + decisions_markdown(
        [MergeDecision(0, (candidate,), None, "none passes", ())], by_evidence=True
    )
    assert " inf " not in shown
    assert "| 0.000 | - |" in shown


def test_each_candidate_of_a_merge_step_has_its_verdict():
    weak, fair, good = (
        MergeCandidate("top", name, 0.5, 0.02, passes=False, **more)
        for name, more in (("rear", {"reason": "too few"}), ("left", {"uncertain": True}), ("front", {}))
    )
    good = replace(good, passes=True)
    best = replace(good, source="right")
    text = decisions_markdown([MergeDecision(0, (weak, fair, good, best), best, "it fits best", ())], by_evidence=True)
    rows = dict(line.strip("| ").split(" | ")[::5] for line in text.splitlines() if line.startswith("| "))
    expected = {"rear": "does not pass", "left": "uncertain", "front": "passes", "right": "merged"}
    assert {name: rows[f"top <- {name}"] for name in expected} == expected
    assert "- top <- rear: too few" in text
    assert "# Merge step 1" in text


def test_what_ranks_the_candidates_is_said_and_shown():
    decisions = state_of().decisions
    by_evidence, by_fitness = (decisions_markdown(decisions, by_evidence=how) for how in (True, False))
    assert "Ranked by evidence." in by_evidence
    assert "Ranked by fitness." in by_fitness
    best = decisions[0].candidates[0]
    assert f"| {best.target} <- {best.source} | 1 | {best.evidence:z.1f} |" in by_evidence
    assert f"| {best.target} <- {best.source} | 1 | - |" in by_fitness


def test_a_candidate_of_two_groups_is_no_pair():
    pair = MergeCandidate("top", "rear", 0.5, 0.02, passes=True)
    assert candidate_label(pair) == "top <- rear"
    assert candidate_label(replace(pair, of_groups=True)) == "top <- rear (groups)"


def test_a_cloud_without_points_is_an_error():
    event = next(event for event in made_events() if isinstance(event, events.CloudPreprocessed))
    assert log_lines(event)[0].level == "INFO"
    empty = replace(event.cloud, points_m=event.cloud.points_m[:0])
    assert log_lines(events.CloudPreprocessed(empty))[0].level == "ERROR"


def test_other_points_have_another_digest():
    events_, state = list(made_events()), RunState()
    index = next(at for at, event in enumerate(events_) if isinstance(event, events.CloudPreprocessed))
    cloud = events_[index].cloud
    events_[index] = events.CloudPreprocessed(replace(cloud, points_m=cloud.points_m[::-1].copy()))
    for event in events_:
        state(event)
    found, before = (each.document.stages.preprocess for each in (state, state_of()))
    assert {name for name in before if found[name] != before[name]} == {cloud.lidar}


def test_notes_of_the_reader_are_warnings():
    first, *_ = made_events()
    assert [line.text for line in log_lines(first) if line.level == "WARN"] == list(first.snapshot.notes)


def test_no_hypothesis_is_a_warning():
    event = next(event for event in made_events() if isinstance(event, events.HypothesesFound))
    empty = events.HypothesesFound(CoarseResult("a", "b", ()), event.correspondences)
    assert log_lines(empty)[0].level == "WARN"


def test_the_summary_of_an_unfinished_run_says_how_far_it_came():
    state = state_of(stop_after=4)
    assert "cut off after stage ingest" in summary_markdown(state)


def test_the_summary_names_what_is_missing_first():
    state = state_of("partial")
    text = summary_markdown(state)
    assert text.startswith("# 1 of 3 LiDARs is not placed. rear: it shares too few surfaces with the others")
    assert "- **rear is not placed: it shares too few surfaces" in text.split("Target:")[0]
    for name in LIDARS:
        assert f"| {name} |" in text


def test_names_cannot_break_a_table():
    decisions = state_of().decisions
    assert decisions
    text = decisions_markdown(decisions, by_evidence=True)
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert {row.count("|") for row in rows} == {7}


def test_the_table_of_hypotheses_has_the_best_of_every_pair():
    state = state_of("failed")
    table = hypotheses_markdown(state)
    evidence = state.registrations["front left/1", "top"].evidence
    assert f"| rear <- top | none | 0 of 80 |{6 * ' - |'}\n" in f"{table}\n"
    assert f"| front left/1 <- top | clique 0 | 20 | 90 | 1 | {evidence:z.1f} | 0.100 | 0.060 | reject |" in table


def test_a_wider_search_is_logged_with_its_voxel_size():
    (line,) = log_lines(events.SearchWidened((("left", "top"), ("rear", "top")), 0.25))
    assert line.level == "INFO"
    assert line.text.endswith("voxels of 0.25 m: left <- top, rear <- top")


@pytest.mark.parametrize(
    ("origin", "name"),
    [("cliques", "clique 0"), ("prior", "the prior"), ("teaserpp", "teaserpp 0"), ("", "hypothesis 0")],
)
def test_the_best_hypothesis_has_the_name_of_its_origin(origin, name):
    event = next(event for event in made_events() if isinstance(event, events.HypothesesVerified))
    best, *others = event.registrations
    changed = replace(event, registrations=(replace(best, origin=origin), *others))
    (line,) = log_lines(changed)
    assert f"{len(others) + 1} distinct poses, {name} has the most evidence: " in line.text


def test_the_summary_says_what_was_next_best():
    def summary(outcome):
        state = state_of(outcome)
        return summary_markdown(state)

    assert "Next best: " in summary("partial")
    assert "Next best: " not in summary("complete")
    assert "Ellipsoids of the rig: 3 sigma" in summary("complete")
    assert "Ellipsoids" not in summary("failed")


def test_without_verification_the_hypotheses_have_no_evidence():
    state, (pair, registered) = RunState(), next(iter(state_of().registrations.items()))
    for event in made_events(until="correspond"):
        state(event)
    found = next(each for each in made_events() if isinstance(each, events.HypothesesFound))
    hypotheses = tuple(replace(each, index=index) for index, each in enumerate(found.coarse.hypotheses))
    state(replace(found, coarse=CoarseResult(*pair, hypotheses)))
    label = pair_label(*pair)
    first, second = (f"| {label} | clique {index} | {count} | - | - | - |" for index, count in ((0, 20), (1, 5)))
    table = hypotheses_markdown(state)
    assert f"{first} - | - | - |" in table
    assert f"{second} - | - | - |" in table
    state(events.PairRegistered(replace(registered, registrations=())))
    table = hypotheses_markdown(state)
    first, second = (row.replace(label, pair_label(registered.target, registered.source)) for row in (first, second))
    assert f"{first} 0.800 | 0.060 | accept |" in table
    assert f"{second} - | - | - |" in table


def test_a_snapshot_that_others_contradict_is_a_warning():
    *_, last = made_events()
    agrees = SnapshotReport("agrees", "a.mcap", "c0ffee")
    reports = (
        agrees,
        replace(agrees, name="outvoted", outliers=("top",)),
        replace(agrees, name="disputed", disputed=("top",)),
        replace(agrees, name="refused", refusal="no returns"),
    )
    lines = log_lines(events.CalibrationFinished(replace(last.result, snapshots=reports)))
    levels = {line.text.split()[1][:-1]: line.level for line in lines if line.text.startswith("snapshot ")}
    assert levels == {"agrees": "INFO", "outvoted": "WARN", "disputed": "WARN", "refused": "WARN"}


FIRST_LINES = {
    events.CalibrationStarted: "INFO calibrating 3 LiDARs of drive.mcap: front left/1 with 1,200 points in 2 frame(s), "
    "rear with 1,200 points in 2 frame(s), top with 1,200 points in 2 frame(s)",
    events.StageStarted: "DEBUG stage ingest started",
    events.StageFinished: "INFO stage ingest finished",
    events.CloudPreprocessed: "INFO front left/1: 600 points after cleaning and thinning; "
    "dropped: 4 too_far, 9 too_near",
    events.FeaturesComputed: "INFO front left/1: 400 descriptors",
    events.CorrespondencesMatched: "INFO front left/1 <- rear: 80 matches",
    events.HypothesesFound: "INFO front left/1 <- rear: 2 hypotheses, 20 of 80 matches agree with the best",
    events.HypothesesVerified: "INFO front left/1 <- rear: 2 distinct poses, clique 0 has the most evidence: -2.0; "
    "90 points agree, 1 lie in proven-empty space, 5 are occluded",
    events.PairRegistered: "INFO rear <- front left/1 from clique 0: fitness 0.800, RMSE 0.060 m "
    "after 12 iterations; accept",
    events.TargetChosen: "INFO target: top (set by --target)",
    events.MergeStepTaken: "INFO merge step 1: merged front left/1 into top; groups: front left/1 + top; rear",
    events.MovableFound: "DEBUG front left/1: 12 of 600 points on objects that could have moved",
    events.RigRefined: "INFO refined over 1 pairs: largest disagreement 4.0 mm, 0.020 deg before, "
    "1.0 mm, 0.010 deg after",
    events.StopsLinked: "INFO 3 stops linked by 2 of 3 registrations between them",
    events.SurfacesMatched: "DEBUG rear <- front left/1: 30 points on surfaces of both at the final pose",
    events.ResidualsMeasured: "INFO front left/1: 30 points on surfaces of other LiDARs, 50 mm off (median)",
    events.GroundEstimated: "INFO the target is 2.000 m above ground: 120 m2 of ground are seen",
    events.CalibrationFinished: "INFO calibration complete: 3 of 3 LiDARs placed",
}


def test_each_line_says_what_happened():
    told = {type(event): log_lines(event)[0] for event in reversed([*made_events(at_stops=True)])}
    lines = {kind: f"{told[kind].level} {told[kind].text}" for kind in FIRST_LINES}
    assert lines == FIRST_LINES


def test_a_cloud_of_which_nothing_is_dropped_says_so():
    event = next(event for event in made_events() if isinstance(event, events.CloudPreprocessed))
    (line,) = log_lines(events.CloudPreprocessed(replace(event.cloud, dropped_m={})))
    assert line.text == "front left/1: 600 points after cleaning and thinning; dropped: none"
