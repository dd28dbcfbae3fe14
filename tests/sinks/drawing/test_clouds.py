# SPDX-License-Identifier: Apache-2.0
"""Samples of clouds."""

from __future__ import annotations

import numpy as np
import pytest

from multilica.sinks.drawing import every_nth, sample_points


@pytest.mark.parametrize("count", [0, 1, 99, 100, 250, 10_001])
def test_a_sample_for_figures_holds_enough_from_beginning_to_end(count):
    points_m = np.arange(3.0 * count).reshape(-1, 3)
    sample_m = every_nth(points_m, 100)
    assert min(count, 100) <= len(sample_m) < 200
    if count:
        assert sample_m[-1, 0] >= 0.98 * points_m[-1, 0]


def test_a_thinned_cloud_is_a_subset_of_limited_size():
    points_m = np.random.default_rng(0).normal(size=(500, 3)).astype(np.float32)
    shown_m = sample_points(points_m, 120)
    assert len(shown_m) == 120
    assert {tuple(point) for point in shown_m.tolist()} <= {tuple(point) for point in points_m.tolist()}
