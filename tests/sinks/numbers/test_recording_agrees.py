# SPDX-License-Identifier: Apache-2.0
"""recording.rrd shows the numbers of the result."""

from __future__ import annotations

import json

import numpy as np
import pytest
import rerun as rr

from multilica.sinks.rerun.reading import read_recorded_table
from tests.sinks.made_events import LIDARS, TRUTH
from tests.sinks.numbers import made_numbers as made
from tests.sinks.numbers.expected import POSED, placement_columns, pose_columns
from tests.sinks.numbers.readers import assert_figures, markdown_tables, pose_of, turn_of_quaternion
from tests.sinks.recording_reader import Recording


@pytest.fixture(scope="module")
def recording(numbered_run):
    return Recording(numbered_run.directory / "recording.rrd")


def document(recording, path):
    return recording.last(path, "TextDocument:text")[0]


def last_pose(recording, path):
    (xyz_m,), (xyzw,) = (recording.last(path, f"Transform3D:{part}") for part in ("translation", "quaternion"))
    (child,), (parent,) = (recording.last(path, f"Transform3D:{part}_frame") for part in ("child", "parent"))
    return parent, child, pose_of(xyz_m, turn_of_quaternion(*xyzw))


@pytest.mark.parametrize("lidar", POSED)
def test_sensors_stand_in_the_target(recording, lidar):
    parent, child, pose = last_pose(recording, rr.new_entity_path(["lidars", lidar, "sensor"]))
    assert (parent, child) == (f"lidar/{made.TOP}", f"lidar/{lidar}")
    np.testing.assert_allclose(pose, TRUTH[lidar].matrix, atol=1e-6)


@pytest.mark.parametrize("lidar", POSED)
def test_ellipsoids_are_the_covariance_of_the_position(recording, lidar):
    path = rr.new_entity_path(["lidars", lidar, "uncertainty"])
    (centre_m,), (half_m,), (xyzw,) = (
        recording.last(path, f"Ellipsoids3D:{part}") for part in ("centers", "half_sizes", "quaternions")
    )
    assert "3 sigma of the position, 10 times enlarged" in document(recording, "/summary")
    turn = turn_of_quaternion(*xyzw)
    covariance = turn @ np.diag((np.array(half_m) / 30.0) ** 2) @ turn.T
    np.testing.assert_allclose(covariance, made.covariance_of(lidar)[3:, 3:], atol=1e-9)
    np.testing.assert_allclose(centre_m, TRUTH[lidar].xyz_m, atol=1e-6)
    assert recording.last(path, "CoordinateFrame:frame") == [f"lidar/{made.TOP}"]


def test_the_ground_lies_below_the_target(recording):
    strips_m = np.array(recording.last("/ground", "LineStrips3D:strips")).reshape(-1, 3)
    up = made.ground().T_base_target.matrix[2, :3]
    np.testing.assert_allclose(strips_m @ up, -made.GROUND_HEIGHT_M, atol=1e-5)


def test_poses_of_the_summary(recording):
    text = document(recording, "/summary")
    rows = {
        name.removesuffix(" (**uncertain**)"): {heading.replace("°", "deg"): cell for heading, cell in cells.items()}
        for name, cells in markdown_tables(text)[0].items()
    }
    for lidar in POSED:
        expected = placement_columns(lidar)
        del expected["fitness"]
        assert_figures(rows[lidar], expected)
    assert_figures(rows[made.TOP], pose_columns(made.TOP))
    assert made.ground_sentence() in text


def test_figures_of_the_pairs(recording):
    (rows,) = markdown_tables(document(recording, "/pair_figures"))
    assert len(rows) == len(made.PAIR_FITNESS)
    for label, cells in rows.items():
        pair = tuple(label.split(" <- "))
        agree, violate, occluded, _ = made.PAIR_COUNTS[pair]
        fitness, coverage = made.PAIR_FITNESS[pair], agree / (agree + violate + occluded)
        known = {"matches": 80, "graph nodes": 80, "graph edges": 200}
        assert cells.pop("violate") == f"{100 * violate / (agree + violate):.1f}%"
        assert_figures(cells, {**known, "fitness": fitness, "coverage": coverage})


def test_scores_of_the_pairs(recording):
    for (target, source), fitness in made.PAIR_FITNESS.items():
        first, second = sorted((target, source))
        path = rr.new_entity_path(["pairs", first, second, "scores"])
        text = document(recording, path)
        (rows,) = markdown_tables(text)
        assert text.startswith(f"# {target} <- {source}\n")
        opposite = f"Fitness and RMSE after a short GICP are those of {first} <- {second}."
        assert (opposite in text) is (first != target)
        (verdict,) = recording.last(path.removesuffix("scores") + "verdict", "Points3D:labels")
        assert verdict.startswith(f"{target} <- {source} ")
        best = {heading: cell.strip("*") for heading, cell in rows["**clique 0**"].items()}
        agree, violate, occluded, _ = made.PAIR_COUNTS[target, source]
        assert best.pop("evidence")
        assert best.pop("step")
        figures = {"fitness": fitness, "RMSE m": made.PAIR_RMSE_MM[target, source] / 1000.0}
        assert_figures(best, {"matches": 20, "agree": agree, "violate": violate, "occluded": occluded} | figures)


def test_rows_of_the_pairs_are_their_registrations(recording, numbered_run):
    rows = read_recorded_table(numbered_run.directory / "recording.rrd", "pairs").to_pylist()
    assert {(row["target"], row["source"]): row["fitness"] for row in rows} == made.PAIR_FITNESS
    for row in rows:
        pose = pose_of([row[f"{axis}_m"] for axis in "xyz"], turn_of_quaternion(*(row[f"q{axis}"] for axis in "xyzw")))
        truth = np.linalg.inv(TRUTH[row["target"]].matrix) @ TRUTH[row["source"]].matrix
        np.testing.assert_allclose(pose, truth, atol=1e-9)
    shown = {
        tuple(label.split(" <- ")): float(cells["fitness"])
        for label, cells in markdown_tables(document(recording, "/hypotheses"))[0].items()
        if cells["fitness"] != "-"
    }
    assert {pair: shown.get(pair, fitness) for pair, fitness in made.PAIR_FITNESS.items()} == made.PAIR_FITNESS


def test_candidates_of_the_merge(recording):
    seen = {
        label.removeprefix(f"{made.TOP} <- "): (float(cells["fitness"]), float(cells["RMSE m"]))
        for table in markdown_tables(document(recording, "/merge/steps"))
        for label, cells in table.items()
    }
    for lidar in POSED:
        expected = (made.MERGE_FITNESS[lidar], made.MERGE_RMSE_MM[lidar] / 1000.0)
        assert seen[lidar] == pytest.approx(expected, abs=5.01e-4)


def cells_by_label(recording, path):
    """Texts of a picture of all pairs by the names beside their row and above their column."""
    labels = recording.last(path, "Points2D:labels")
    places = [tuple(place) for place in recording.last(path, "Points2D:positions")]
    left, above = min(x for x, _ in places), min(y for _, y in places)
    rows = {y: text for (x, y), text in zip(places, labels, strict=True) if x == left}
    columns = {x: text for (x, y), text in zip(places, labels, strict=True) if y == above}
    assert {*rows.values()} == {*columns.values()} == {*LIDARS}
    return {(rows[y], columns[x]): text for (x, y), text in zip(places, labels, strict=True) if x > left and y > above}


def test_matrices_have_the_target_in_rows(recording):
    assert "target in rows, the source in columns" in document(recording, "/pair_figures")
    expected = {pair: f"{fitness:.2f}" for pair, fitness in made.PAIR_FITNESS.items()}
    assert cells_by_label(recording, "/fitness/labels") == expected
    assert {*cells_by_label(recording, "/coverage/labels")} == {*cells_by_label(recording, "/verdicts/labels")}
    assert {*cells_by_label(recording, "/verdicts/labels")} == {*expected}
    (tensor,) = recording.last("/fitness", "Tensor:data")
    assert tensor["names"] == ["target", "source"]
    values = np.array(tensor["buffer"]).reshape(tensor["shape"])
    found = {(LIDARS[row], LIDARS[column]): values[row, column] for row, column in np.argwhere(np.isfinite(values))}
    assert found == pytest.approx(made.PAIR_FITNESS, abs=1e-6)


def test_squares_of_the_matrices_lie_below_their_texts(recording):
    (picture,) = recording.last("/verdicts/picture", "Image:buffer")
    ((width, height),) = (
        [each["width"], each["height"]] for each in recording.last("/verdicts/picture", "Image:format")
    )
    pixels = np.array(picture, dtype=np.uint8).reshape(height, width, 3)
    labels = recording.last("/verdicts/labels", "Points2D:labels")
    places = recording.last("/verdicts/labels", "Points2D:positions")
    inside = [(text, tuple(pixels[int(y), int(x)])) for text, (x, y) in zip(labels, places, strict=True) if x > 0 < y]
    colours = {text: {colour for word, colour in inside if word == text} for text, _ in inside}
    assert {*colours} == {"accept", "uncertain"}
    assert all(len(found) == 1 for found in colours.values())
    assert colours["accept"] != colours["uncertain"]
    empty = tuple(pixels[height // 6, width // 6])
    assert not {empty} & set.union(*colours.values())


def test_the_result_in_the_recording_is_that_of_the_file(recording, numbered_run):
    written = json.loads((numbered_run.directory / "result.json").read_text(encoding="utf-8"))
    assert json.loads(document(recording, "/result")) == written | {"timing_s": {}}
