# SPDX-License-Identifier: Apache-2.0
"""Points land where they belong."""

from __future__ import annotations

import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from multilica.geometry import RigidTransform
from multilica.sinks.report.figures import (
    GROUND_COLOUR,
    Layer,
    View,
    draw_clouds,
    png_bytes,
    side_view,
    top_view,
)

RED, BLUE = (255, 0, 0), (0, 0, 255)
VIEW = View(0, 1, (5.0, -5.0), 20.0, (200, 100))


def drawn(view: View, *layers: Layer) -> np.ndarray:
    return np.asarray(draw_clouds(view, layers)).astype(int)


@given(column=st.integers(0, 199), row=st.integers(0, 69))  # the scale lies below
def test_a_point_colours_its_own_pixel(column, row):
    x, y = -5.0 + (column + 0.5) / 10.0, -((row + 0.5) / 10.0)
    picture = drawn(VIEW, Layer(np.array([[x, y, 3.0]]), RED))
    assert picture[row, column, 0] > 150
    picture[row, column] = GROUND_COLOUR
    assert np.all(picture[:70] == GROUND_COLOUR)


def test_no_layer_hides_another():
    point = np.array([[5.0, -2.0, 0.0]])
    both = drawn(VIEW, Layer(point, RED), Layer(point, BLUE))[20, 100]
    other_way_round = drawn(VIEW, Layer(point, BLUE), Layer(point, RED))[20, 100]
    assert np.array_equal(both, other_way_round)
    assert both[0] == pytest.approx(both[2], abs=1)
    assert both[0] > 100


def test_nearly_all_points_are_in_view_with_the_origin():
    points_m = np.random.default_rng(3).normal((12.0, -4.0, 2.0), (6.0, 3.0, 1.0), (5000, 3))
    for view in (top_view(points_m, (600, 400)), side_view(points_m, 600)):
        at = view.project(np.vstack([points_m, np.zeros(3)]))
        inside = np.all((at >= 0) & (at <= view.size_px), axis=1)
        assert inside.mean() > 0.85
        assert inside[-1]


def test_sensors_are_in_view_however_far_from_the_points():
    points_m = np.random.default_rng(3).normal((12.0, 0.0, 2.0), (2.0, 2.0, 1.0), (5000, 3))
    sensors_m = [np.array([-6.0, 30.0, 1.0]), np.zeros(3)]
    view = top_view(points_m, (600, 400), sensors_m)
    at = view.project(np.array(sensors_m))
    assert np.all((at > 0) & (at < view.size_px))


@pytest.mark.parametrize("points_m", [np.empty((0, 3)), np.zeros((1, 3)), np.full((4, 3), 500.0)])
def test_odd_clouds_make_a_picture_all_the_same(points_m):
    sensor = RigidTransform.identity("level", "rear")
    for view in (top_view(points_m, (120, 80)), side_view(points_m, 120)):
        png = png_bytes(draw_clouds(view, [Layer(points_m, RED, sensor=sensor, label="rear")]))
        assert Image.open(io.BytesIO(png)).size == view.size_px


@pytest.mark.parametrize("label", ["two\nlines", "x" * 500, "\u8eca\x00", "  "])
def test_any_name_can_be_a_label(label):
    layer = Layer(np.zeros((1, 3)), RED, sensor=RigidTransform.identity("level", "a"), label=label)
    assert drawn(VIEW, layer).shape == (100, 200, 3)


def test_labels_of_sensors_in_one_place_do_not_cover_each_other():
    sensor = RigidTransform.identity("level", "a")
    nothing = np.empty((0, 3))
    view = View(0, 1, (0.0, 0.0), 20.0, (600, 300))
    picture = drawn(view, *(Layer(nothing, colour, sensor=sensor, label="MMM") for colour in (RED, BLUE)))
    rows_of = [np.flatnonzero((picture == colour).all(axis=2).sum(axis=1) > 3) for colour in (RED, BLUE)]
    assert all(len(rows) > 0 for rows in rows_of)
    assert rows_of[0].max() < rows_of[1].min()


def test_labels_of_sensors_at_one_height_keep_their_order():
    view = View(0, 1, (0.0, 0.0), 20.0, (600, 300))
    layers = [
        Layer(np.empty((0, 3)), colour, label="MMM", sensor=RigidTransform.from_xyz_rpy("level", "a", xyz_m, (0, 0, 0)))
        for colour, xyz_m in ((RED, (1.0, -1e-12, 0.0)), (BLUE, (-1.0, 1e-12, 0.0)))
    ]
    picture = drawn(view, *layers)
    rows_of = [np.flatnonzero((picture == colour).all(axis=2).sum(axis=1) > 3) for colour in (RED, BLUE)]
    assert rows_of[0].mean() < rows_of[1].mean()
