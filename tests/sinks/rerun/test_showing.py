# SPDX-License-Identifier: Apache-2.0
"""Colours and samples."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from multilica.sinks.drawing import distinct_colours, heat_colours, sample_indices, sample_points


def luminance_and_hue(colour) -> np.ndarray:
    """Project to what remains visible with red-green blindness."""
    red, green, blue = np.asarray(colour, dtype=float)
    return np.array([0.3 * red + 0.6 * green + 0.1 * blue, blue])


def test_lidars_are_told_apart_without_red_and_green():
    colours = distinct_colours(["a", "b", "c", "d"]).values()
    for one, other in combinations(colours, 2):
        assert np.linalg.norm(luminance_and_hue(one) - luminance_and_hue(other)) > 30.0


def test_a_colour_belongs_to_the_place_of_a_name():
    assert distinct_colours(["a", "b"])["b"] == distinct_colours(["x", "y"])["y"]
    assert len(distinct_colours([str(number) for number in range(20)])) == 20


def test_heat_rises_and_what_is_unknown_is_grey():
    colours = heat_colours(np.array([0.0, 0.5, 1.0, np.nan]))
    assert colours[:3, 1].tolist() == sorted(colours[:3, 1])
    assert len(set(colours[3].tolist())) == 1


def test_samples_are_bounded_sorted_and_repeatable():
    rows = sample_indices(1000, 10)
    assert len(rows) == 10
    assert rows.tolist() == sorted(set(rows.tolist()))
    assert rows.tolist() == sample_indices(1000, 10).tolist()
    assert sample_indices(5, 10).tolist() == [0, 1, 2, 3, 4]


def test_sampled_points_are_rows_of_the_cloud():
    cloud = np.arange(300.0).reshape(100, 3)
    sample = sample_points(cloud, 7)
    assert sample.dtype == np.float32
    assert sample.shape == (7, 3)
    assert all(row in cloud[:, 0] for row in sample[:, 0])
