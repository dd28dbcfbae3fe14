# SPDX-License-Identifier: Apache-2.0
"""Contents of reports."""

from __future__ import annotations

import base64
import re
from dataclasses import replace

import numpy as np
import pytest

from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.sinks.report.contents import ReportContents, contents_of
from multilica.sinks.report.page import opponents, report_html
from multilica.sinks.report.rig import refused_poses, rig_scene
from multilica.sinks.run_state import RunState
from tests.sinks.made_events import TRUTH, UNPLACED, made_events
from tests.sinks.report.conftest import STOPPED, made_contents, with_values

LEVEL = RigidTransform.from_xyz_rpy("level", "top", (0.0, 0.0, 2.0), (0.0, 0.1, 0.0))


@pytest.fixture(scope="module")
def partial():
    return made_contents("partial")


def test_success_and_failure_have_their_sentence(partial):
    assert made_contents("complete").explanation.headline == "All 3 LiDARs are placed. The target is top."
    assert partial.explanation.headline == (
        "1 of 3 LiDARs is not placed. rear: it shares too few surfaces with the others (no overlap)."
    )
    assert made_contents("failed").explanation.headline == (
        "2 of 3 LiDARs are not placed. front left/1 and rear: it shares too few surfaces with the others (no overlap)."
    )


def test_a_failure_names_lidar_step_partner_and_reason(partial):
    (failure,) = partial.explanation.missing
    assert failure.lidar == UNPLACED
    assert failure.step.startswith("fine")
    assert opponents(failure) in {("top",), ("front left/1",)}
    assert "only 12 points lie on walls" in failure.decisive.sentence


def test_a_lidar_without_any_pose_failed_in_coarse():
    failures = {one.lidar: one for one in made_contents("failed").explanation.missing}
    assert failures[UNPLACED].step.startswith("coarse")
    assert failures[UNPLACED].decisive is None


def test_a_pose_far_from_its_prior_is_noted():
    turned = TRUTH["rear"] @ RigidTransform.from_xyz_rpy("rear", "rear", (0, 0, 0), (0, 0, 2))
    claim = Extrinsics("top", TRUTH | {"rear": turned})
    *_, note = made_contents("complete", prior=claim).notes
    assert note.startswith("rear is turned by 115 deg about its z axis against its prior")


def test_a_run_that_was_to_stop_has_not_failed():
    outcome = made_contents("complete", until="coarse")
    assert outcome.badge == "stopped"
    assert "after stage coarse (--until)" in outcome.explanation.headline
    assert outcome.explanation.missing == ()


def test_a_run_that_ended_early_tells_why_first():
    state = RunState()
    for event in list(made_events())[:12]:
        state(event)
    outcome = contents_of(state, ended_early=STOPPED)
    assert outcome.badge == "ended early"
    assert "in stage features" in outcome.explanation.headline
    assert outcome.details == (STOPPED,)
    assert outcome.explanation.known


def test_a_refused_snapshot_is_named_as_such(partial):
    refusal = {"code": "moving_vehicle", "text": "The vehicle moves in drive.mcap."}
    outcome = with_values(partial, refusal=refusal)
    assert outcome.badge == "refused"
    assert "the vehicle moved" in outcome.explanation.headline
    assert outcome.explanation.known == (refusal["text"],)
    assert outcome.explanation.advice


def test_a_doubtful_sensor_is_a_warning_even_where_all_is_placed():
    contents = made_contents("complete")
    dirt = {"code": "dirty", "value": 0.4, "limit": 0.1, "text": "40% of its field of view ends nearer than 1 m"}
    lidars = contents.document.model_dump(mode="json")["lidars"]
    lidars["rear"]["health"] = {"returns": 9, "near_share": 0.4, "blockage_ratio": 0.4, "reasons": [dirt]}
    (warning,) = with_values(contents, lidars=lidars).explanation.warnings
    assert "rear" in warning
    assert dirt["text"] in warning


def test_nothing_is_reported_before_a_run_has_started():
    with pytest.raises(ValueError, match="before a calibration has started"):
        contents_of(RunState())


def rows(page: str, section: str) -> list[list[str]]:
    """The texts of the cells of a section, a list per row of its tables."""
    body = page.split(f'<h2 id="{section}">')[1].split("</section>", maxsplit=1)[0]
    found = (re.findall(r"<t[dh]\b.*?</t[dh]>", row, re.DOTALL) for row in re.findall(r"<tr>.*?</tr>", body, re.DOTALL))
    return [[" ".join(re.sub(r"<[^>]+>", " ", cell).split()) for cell in cells] for cells in found]


def test_rows_hold_the_figures_of_the_document(partial):
    page = report_html(partial)
    shown = {name: cells for name, *cells in rows(page, "result")[1:]}
    xyz, rpy = TRUTH["front left/1"].xyz_m, TRUTH["front left/1"].rpy_deg
    pose = [*(f"{value:.3f}" for value in xyz), *(f"{value:.2f}" for value in rpy)]
    assert shown["front left/1"][:7] == ["placed", *pose]
    assert len({len(cells) for cells in shown.values()}) == 1
    assert shown["rear"] == ["not placed", *["-"] * 10]
    assert (shown["top"][0], shown["top"][7:]) == ("target", ["-"] * 4)
    assert [stage for stage, *_ in rows(page, "timings")[1:]] == ["fine"]  # that of a stage without a time is left out


def test_each_snapshot_of_a_joint_result_has_its_verdict(partial):
    off = [{"lidar": "rear", "distance_m": 0.0021, "angle_deg": 0.05, "outlier": False}]
    agrees = {
        "name": "a",
        "source": "a.mcap",
        "sha256": "",
        "refusal": None,
        "outliers": [],
        "disputed": [],
        "deviations": off,
    }
    left_out = {**agrees, "name": "b", "refusal": "the vehicle moves", "deviations": []}
    outvoted = {**agrees, "name": "c", "outliers": ["rear"], "disputed": ["top"]}
    silent = {**agrees, "name": "d", "deviations": []}
    joint = with_values(partial, snapshots=[agrees, left_out, outvoted, silent])
    assert [(verdict, *off) for _, verdict, *off, _ in rows(report_html(joint), "snapshots")[1:]] == [
        ("Agrees.", "2.1", "0.050"),
        ("Left out: the vehicle moves.", "-", "-"),
        ("Outvoted on rear. Contradicts others on top (undecided).", "2.1", "0.050"),
        ("Places no LiDAR relative to the target.", "-", "-"),
    ]
    assert 'id="snapshots"' not in report_html(partial)


def test_the_matrix_has_each_pair_once_and_the_right_way_round(partial):
    header, *matrix = rows(report_html(partial), "pairs")[: 1 + len(partial.document.lidars)]
    assert header == ["", *partial.document.lidars]
    filled = {
        (target, [*partial.document.lidars][column]): cell.split()[1]
        for target, *cells in matrix
        for column, cell in enumerate(cells)
        if cell
    }
    expected = {(one.target, one.source): one.verdict.outcome for one in partial.document.pairs}
    assert filled == expected


def test_the_graph_marks_the_pairs_of_the_merge(partial):
    graph = report_html(partial).split('<svg class="graph"')[1].split("</svg>")[0]
    edges = re.findall(
        r"([^.]+?) on ([^:]+): (\w+), pair fitness [\d.]+, evidence [-\d.]+\. ", graph.split('id="graph-text">')[1]
    )
    outcomes = {frozenset(map(str.strip, lidars)): outcome for *lidars, outcome in edges}
    assert outcomes[frozenset(("top", "front left/1"))] == "merged"
    assert outcomes[frozenset(("top", "rear"))] == "reject"
    nodes = re.findall(r'class="node( unplaced)?" cx="([\d.]+)" cy="([\d.]+)"', graph)
    assert [bool(unplaced) for unplaced, *_ in nodes] == [name == "rear" for name in partial.document.lidars]
    assert len({(x, y) for _, x, y in nodes}) == len(partial.document.lidars)


def test_the_scene_gives_the_points_back(partial):
    scene = rig_scene(replace(partial, level=LEVEL), max_points=3000)
    for cloud in scene["clouds"]:
        steps = np.frombuffer(base64.b64decode(cloud["points"]), dtype="<u2").reshape(-1, 3)
        points_m = np.array(cloud["low"]) + np.array(cloud["span"]) * steps / 65_535
        assert len(points_m) == cloud["count"] == min(1000, len(partial.clouds[cloud["name"]]))
        known = {tuple(point) for point in np.round(partial.clouds[cloud["name"]], 2)}
        near = [tuple(point) in known for point in np.round(points_m, 2)]
        assert np.mean(near) > 0.5  # rounding may fall to either side
        pose = np.array(cloud["pose"]).reshape(4, 4).T
        assert np.allclose(pose, (LEVEL @ TRUTH[cloud["name"]]).matrix, atol=1e-6)
    assert [cloud["placed"] for cloud in scene["clouds"]] == [True, False, True]


def test_a_sample_of_the_points_is_told_as_such(partial):
    counted = sum(each.points for each in partial.document.stages.preprocess.values())
    some = ReportContents(partial.document, {name: cloud[:100] for name, cloud in partial.clouds.items()})
    assert f"Thinned at random to 300 of {counted:,} points." in report_html(some)


def test_a_refused_pose_is_taken_from_a_placed_partner(partial):
    poses = refused_poses(partial)
    assert set(poses) == {"rear"}
    assert np.allclose(poses["rear"].matrix, TRUTH["rear"].matrix, atol=1e-6)
