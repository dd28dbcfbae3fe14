# SPDX-License-Identifier: Apache-2.0
"""An explanation names the cause that the document holds."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from multilica.config import STAGES
from multilica.diagnosis import CAUSES
from multilica.diagnosis import explain as explain_document
from multilica.diagnosis.explanation import PRIOR_ADVICE, cause_of_codes
from multilica.events import PairRegistered, StageFinished
from multilica.geometry import RigidTransform
from multilica.orchestration.pairs import PAIR_STAGES
from multilica.results.values import OPEN_POSE
from tests.sinks.made_documents import made_document, parsed
from tests.sinks.made_events import UNPLACED, made_events

ROOT = Path(__file__).resolve().parents[2]


def explain(document):
    return explain_document(parsed(document))


def reason(code, text):
    return {"code": code, "value": 1.0, "limit": 2.0, "text": text}


def health(*reasons):
    return {"returns": 9, "near_share": 0.0, "blockage_ratio": 0.0, "reasons": list(reasons)}


def prior_of(entry, surprise=None):
    pose = {key: entry[key] for key in ("T_target_source", "xyz_m", "rpy_deg", "quaternion_xyzw")}
    return {**pose, "deviation_m": None, "deviation_deg": None, "surprise": surprise}


@pytest.fixture
def partial():
    return made_document("partial")


def missing_of(document):
    (missing,) = explain(document).missing
    return missing


def set_reasons(document, outcome, *codes):
    reasons = [reason(code, f"figure of {code}; expected 2") for code in codes]
    for pair in document["pairs"]:
        if UNPLACED in (pair["target"], pair["source"]):
            pair["verdict"] = {"outcome": outcome, "reasons": reasons}


def test_complete_run_has_headline_and_sigmas():
    document = made_document("complete")
    turn = np.kron(np.eye(2), RigidTransform.from_xyz_rpy("", "", (0, 0, 0), (0.0, 0.0, np.pi / 4)).rotation)
    variances = np.square([*np.deg2rad([0.01, 0.02, 0.005]), 0.001, 0.0042, 0.002])  # along axes between x and y
    document["lidars"]["rear"] |= {"covariance": (turn @ np.diag(variances) @ turn.T).tolist()}
    document["lidars"]["front left/1"] |= {"covariance": None}
    told = explain(document)
    assert told.headline == "All 3 LiDARs are placed. The target is top."
    assert (told.missing, told.warnings, told.cause) == ((), (), None)
    assert [(one.lidar, one.sigma_m) for one in told.placed] == [
        ("front left/1", None),
        ("rear", pytest.approx(0.0042)),
    ]
    assert told.placed[1].sentence == "rear is placed relative to top: sigma 4.2 mm, 0.020 deg."
    assert "no uncertainty available" in told.placed[0].sentence


@pytest.mark.parametrize(
    ("outcome", "codes", "cause"),
    [
        ("reject", ("too_little_evidence", "ambiguous"), "no_overlap"),
        ("uncertain", ("imprecise",), "uncertain"),
        ("reject", ("empty_space_violated",), "contradiction"),
        ("undecided", ("ambiguous", "not_observable"), "ambiguous"),
        ("undecided", ("not_observable",), "not_observable"),
        ("reject", ("structure_unexplained",), "unexplained"),
        ("reject", ("low_fitness",), "low_fitness"),
        ("reject", ("against_prior",), "against_prior"),
        ("reject", ("a_code_of_tomorrow",), "unknown"),
    ],
)
def test_the_verdict_of_the_decisive_pair_gives_the_cause(partial, outcome, codes, cause):
    set_reasons(partial, outcome, *codes)
    missing = missing_of(partial)
    assert missing.cause == cause
    assert missing.headline == f"{UNPLACED} is not placed: {CAUSES[cause][0]}."
    assert CAUSES[cause][0] in explain(partial).headline
    assert missing.advice == CAUSES[cause][1:]
    assert missing.decisive.codes == codes
    assert f"figure of {codes[0]}, expected 2" in missing.decisive.sentence


def test_pair_nearest_to_acceptance_is_decisive(partial):
    set_reasons(partial, "reject", "too_little_evidence")
    closest = next(pair for pair in partial["pairs"] if (pair["target"], pair["source"]) == ("rear", "top"))
    closest["verdict"] = {"outcome": "undecided", "reasons": [reason("ambiguous", "twice")]}
    closest["registrations"] = closest["registrations"][:1]
    missing = missing_of(partial)
    assert (missing.decisive.target, missing.decisive.source) == ("rear", "top")
    assert missing.cause == "ambiguous"
    assert missing.next_best.startswith("front left/1 against rear")


def test_the_stage_at_which_it_failed_is_told_below_its_cause(partial):
    lines = explain(partial).lines
    assert (
        lines[lines.index(missing_of(partial).headline) + 1]
        == "  At stage fine: the pair was registered but not accepted."
    )


def test_a_second_pose_of_the_decisive_pair_is_the_next_best(partial):
    for pair in partial["pairs"]:
        other = pair["registrations"][0] | {"agree": 77, "violate": 3, "evidence": 4.12}
        pair["registrations"] = [pair["registrations"][0], other]
    assert "has an evidence of 4.1 (the decisive pose" in missing_of(partial).next_best
    assert "77 points agree and 3 lie in proven-empty space" in missing_of(partial).next_best
    for pair in partial["pairs"]:
        pair["registrations"][1]["evidence"] = -1e-12
    assert "has an evidence of 0.0 (the decisive pose" in missing_of(partial).next_best


def test_pairs_within_the_missing_group_decide_nothing():
    document = made_document("failed")
    document["decisions"][-1]["groups"] = [["top"], ["front left/1", "rear"]]
    inside = document["pairs"][0] | {
        "target": "front left/1",
        "source": "rear",
        "verdict": {"outcome": "accept", "reasons": []},
    }
    document["pairs"].append(inside)
    for missing in explain(document).missing:
        assert {missing.decisive.target, missing.decisive.source} == {"front left/1", "top"}
    told = {missing.lidar: missing for missing in explain(document).missing}
    assert (told["front left/1"].cause, told["rear"].cause) == ("no_overlap", "not_joined")
    assert told["rear"].decisive.sentence.startswith("rear fits front left/1, which is not placed. ")


def test_an_accepted_pair_of_a_group_that_was_not_joined(partial):
    partial["decisions"][-1]["groups"] = [["top"], ["front left/1", "rear"]]
    set_reasons(partial, "accept")
    assert missing_of(partial).cause == "not_joined"


def test_a_joined_lidar_whose_pose_is_open_is_not_constrained(partial):
    set_reasons(partial, "accept")
    partial["lidars"][UNPLACED]["reason"] = f"{OPEN_POSE}: sigma 5400 mm, limit 20 mm"
    missing = missing_of(partial)
    assert missing.cause == "not_observable"
    assert missing.decisive.sentence == "the scene leaves its pose open in one direction: sigma 5400 mm, limit 20 mm."
    assert UNPLACED in missing.decisive.key
    assert missing.step.startswith("refine: ")


@pytest.mark.parametrize("code", ["dead", "dirty"])
def test_a_fault_of_the_sensor_comes_before_that_of_its_pairs(partial, code):
    partial["lidars"][UNPLACED]["health"] = health(reason(code, "48% of it"))
    assert missing_of(partial).cause == f"{code}_sensor"


def test_empty_cloud_without_figures_is_a_dead_sensor(partial):
    partial["input"]["lidars"][UNPLACED]["points"] = 0
    del partial["stages"], partial["progress"]
    assert missing_of(partial).cause == "dead_sensor"


def test_returns_that_are_all_dropped(partial):
    partial["stages"]["preprocess"][UNPLACED]["points"] = 0
    assert missing_of(partial).cause == "no_returns_in_range"


def test_no_pair_at_all_is_no_overlap(partial):
    partial["pairs"] = []
    missing = missing_of(partial)
    assert (missing.cause, missing.decisive, missing.next_best) == ("no_overlap", None, "")


def test_a_dirty_sensor_that_was_placed_is_a_warning():
    document = made_document("complete")
    document["lidars"]["rear"]["health"] = health(reason("dirty", "48% of its field of view"))
    (warning,) = explain(document).warnings
    assert warning == "rear has a dirty or covered window: 48% of its field of view."
    assert f"Warning: {warning}" in explain(document).findings


def test_a_lidar_mounted_against_its_prior_is_a_warning():
    document = made_document("complete")
    sentence = "rear is turned by 179 deg about its z against its prior: rear or top is mounted backwards."
    document["lidars"]["rear"]["prior"] = prior_of(document["lidars"]["rear"], sentence)
    document["lidars"]["top"]["prior"] = prior_of(document["lidars"]["top"])
    assert explain(document).warnings == (sentence,)


_BIAS_FIELDS = (
    *("range_m", "range_sigma_m", "elevation_deg", "elevation_sigma_deg"),
    *("range_scale_ppm", "range_scale_sigma_ppm", "glancing_m", "glancing_sigma_m"),
)


@pytest.mark.parametrize(
    ("bias", "told"),
    [
        ({"range_m": 0.039, "elevation_deg": 0.019, "range_scale_ppm": 790.0, "glancing_m": 0.019}, ""),
        ({"range_m": -0.052}, "its ranges, 5 times its usual size (refine.range_bias_sigma_m)"),
        (
            {"elevation_deg": 0.026, "range_m": 0.01},
            "its elevation angles, 5 times its usual size (refine.elevation_bias",
        ),
        ({"range_scale_ppm": -1040.0}, "the scale of its ranges, 5 times its usual size (refine.range_scale_sigma)"),
        ({"glancing_m": 0.026}, "its ranges on grazed surfaces, 5 times its usual size (refine.glancing_bias_sigma_m)"),
    ],
)
def test_a_lidar_with_an_implausible_bias_is_a_warning(bias, told):
    document = made_document("complete")
    none = {"m": 0.0, "deg": 0.0}
    document["refinement"] = {
        "cycle_error_before": none,
        "cycle_error_after": none,
        "pairs": [],
        "biases": [dict.fromkeys(_BIAS_FIELDS, 0.0) | {"lidar": "rear"} | bias],
    }
    warnings = explain(document).warnings
    expected = f"rear seems to have an error in {told}"
    assert [each.startswith(expected) for each in warnings] == [True] * bool(told)


def test_a_pair_that_contradicts_the_others_is_a_warning():
    document = made_document("complete")
    errors = {"before_m": 0.4, "before_deg": 1.2, "after_m": 0.1, "after_deg": 0.3, "apart_m": 0.5, "apart_deg": 1.5}
    pair = {"target": "top", "source": "rear", "weight": 0.1, "probability": 1e-5, "snapshot": "", **errors}
    largest = {"m": 0.5, "deg": 1.5}
    document["refinement"] = {
        "cycle_error_before": largest,
        "cycle_error_after": largest,
        "pairs": [pair, pair | {"weight": 0.9, "probability": 0.01}],
    }
    assert len(explain(document).warnings) == 1
    assert "contradicts the others by 0.500 m, 1.50 deg" in explain(document).warnings[0]


@pytest.mark.parametrize(("code", "cause"), [("moving_vehicle", "moving_vehicle"), ("too_few_lidars", "unfit_input")])
def test_a_refused_snapshot(code, cause):
    document = {**made_document("failed"), "refusal": {"code": code, "text": "The vehicle moves: top by 1 m."}}
    told = explain(document)
    assert told.cause == cause
    assert CAUSES[cause][0] in told.headline
    assert told.known == ("The vehicle moves: top by 1 m.",)
    assert told.missing == ()


@pytest.mark.parametrize("stage", STAGES[1:])
def test_a_run_that_was_cut_off_says_how_far_it_came(stage):
    count = _events_before_the_end_of(stage)
    told = explain(made_document("partial", stop_after=count))
    before, running = STAGES[STAGES.index(stage) - 1], "fine" if stage in PAIR_STAGES else stage
    assert told.headline.startswith(f"The run was cut off after stage {before}, in stage {running}. No LiDAR")
    assert told.cause == "unfinished"
    assert bool(told.known) == (stage != "preprocess")


def test_a_run_cut_off_among_the_pairs_tells_those_it_has():
    count = 1 + next(i for i, event in enumerate(made_events("partial")) if isinstance(event, PairRegistered))
    assert explain(made_document("partial", stop_after=count)).known == ("rear <- front left/1: reject, fitness 0.10.",)


def _events_before_the_end_of(stage):
    told = list(made_events("partial"))
    return next(i for i, event in enumerate(told) if isinstance(event, StageFinished) and event.stage == stage)


def test_a_run_that_was_to_stop_early_did_what_was_asked():
    told = explain(made_document("complete", until="coarse"))
    assert told.headline == "The run stopped after stage coarse (--until). No LiDAR is placed yet."
    assert told.known[0] == "front left/1 <- rear: 2 hypotheses."


def test_several_with_one_cause_are_told_together():
    document = made_document("failed")
    document["pairs"] = []
    assert "front left/1 and rear: it shares too few surfaces" in explain(document).headline


def jointly(document, *disputed, reason="monday and tuesday place it 0.300 m apart"):
    """As of two snapshots, of which one's pairs are told."""
    document["decisions"] = []
    tuesday = {"name": "tuesday", "source": "", "sha256": "", "refusal": None}
    tuesday |= {"outliers": [], "disputed": [], "deviations": []}
    document["snapshots"] = [tuesday | {"name": "monday", "disputed": list(disputed)}, tuesday]
    document["lidars"]["rear"]["reason"] = reason
    return document


def test_joint_run_takes_the_pair_of_the_shown_snapshot(partial):
    set_reasons(partial, "undecided", "ambiguous")
    missing = missing_of(jointly(partial))
    assert missing.cause == "ambiguous"
    assert "rear" in (missing.decisive.target, missing.decisive.source)
    assert missing.by_snapshot == "monday and tuesday place it 0.300 m apart."


def test_snapshots_that_do_not_count_are_told():
    complete = jointly(made_document("complete"))
    assert "(one of them: " in explain(complete).input
    monday, tuesday = complete["snapshots"]
    off = {"lidar": "rear", "distance_m": 0.08, "angle_deg": 0.5, "outlier": True, "probability": None}
    tuesday |= {"outliers": ["rear"], "deviations": [off | {"contradicts": []}]}
    monday["refusal"] = "The vehicle moves."
    told = explain(complete).warnings
    assert told[0] == "monday is left out: The vehicle moves."
    assert told[1].startswith("tuesday places rear 80.0 mm, 0.500 deg from the other snapshots, which outvote it.")
    knock = {"lidar": "rear", "before": "monday", "after": "tuesday", "distance_m": 0.08, "angle_deg": 0.5}
    complete["knocks"] = [knock | {"left_out": ["tuesday"]}]
    assert not [each for each in explain(complete).warnings if "outvote" in each]


@pytest.mark.parametrize(("disputed", "cause"), [(("rear",), "disputed"), (("top",), "not_joined"), ((), "not_joined")])
def test_of_several_snapshots_an_accepted_pair_decides_nothing(partial, disputed, cause):
    set_reasons(partial, "accept")
    missing = missing_of(jointly(partial, *disputed))
    assert (missing.cause, missing.decisive, missing.next_best) == (cause, None, "")
    assert missing.by_snapshot == "monday and tuesday place it 0.300 m apart."
    assert "  By snapshot: monday and tuesday place it 0.300 m apart." in explain(partial).lines


def test_a_dispute_of_snapshots_comes_before_a_refused_pair(partial):
    set_reasons(partial, "undecided", "ambiguous")
    assert missing_of(jointly(partial, "rear")).cause == "disputed"
    reason = "monday: connected through pairs that contradict other snapshots on top"
    missing = missing_of(jointly(partial, "top", reason=reason))
    assert (missing.cause, missing.by_snapshot) == ("disputed", f"{reason}.")


def test_lidar_missing_in_the_shown_snapshot_is_not_dead(partial):
    partial["pairs"] = []
    partial["input"]["lidars"]["rear"]["points"] = 0
    partial["stages"]["preprocess"]["rear"]["points"] = 0
    assert missing_of(jointly(partial)).cause == "unknown"


def test_every_code_of_the_decision_has_a_cause():
    decide = "".join(
        (ROOT / "multilica" / "acceptance" / f"{name}.py").read_text() for name in ("accept", "rig", "placement")
    )
    codes = set(re.findall(r'(?:Reason\(\s*|_CODE = |^        )"(\w+)"(?=[,:\n])', decide, re.MULTILINE))
    assert len(codes) == 12
    assert {code for code in codes if cause_of_codes([code]) == "unknown"} == set()


def test_every_cause_has_words_advice_and_documentation():
    page = (ROOT / "docs" / "cookbook.md").read_text(encoding="utf-8")
    for cause in CAUSES:
        assert CAUSES[cause][0]
        assert CAUSES[cause][1:]
        assert f"`{cause}`" in page


def test_a_prior_is_no_advice_to_who_gave_one(partial):
    set_reasons(partial, "reject", "too_little_evidence")
    assert PRIOR_ADVICE in missing_of(partial).advice
    partial["lidars"][UNPLACED]["prior"] = prior_of(partial["lidars"]["top"])
    assert missing_of(partial).advice == tuple(one for one in CAUSES["no_overlap"][1:] if one != PRIOR_ADVICE)


@pytest.mark.parametrize("cause", ["ambiguous", "two_places", "not_in_rig"])
def test_a_prior_is_no_advice_where_the_scene_does_not_decide(cause):
    assert PRIOR_ADVICE not in CAUSES[cause][1:]
