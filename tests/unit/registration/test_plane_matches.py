# SPDX-License-Identifier: Apache-2.0
"""Points of a source count only on surfaces that the target sees from the same side."""

import numpy as np
import pytest

from multilica.config import FineConfig
from multilica.geometry import RigidTransform
from multilica.registration.gicp import prepare_gicp_cloud
from multilica.registration.plane_matches import find_overlap, find_residuals, sides_of
from multilica.registration.sensor_biases import BIAS_COUNT
from tests.unit.made_rooms import Face, box, scan

_BOARD = [Face(2, 0.0, (-20.0, -20.0, 0.0), (20.0, 20.0, 0.0)), *box((0.0, -3.0, 0.0), (0.08, 3.0, 2.5))]
_TARGET = RigidTransform.from_xyz_rpy("world", "t", [-5.0, 0.0, 1.5], [0.0, 0.0, 0.3])


@pytest.mark.parametrize(("x_m", "counts"), [(-4.0, True), (4.0, False)], ids=["same side", "other side"])
def test_a_board_seen_from_both_sides_is_no_common_surface(x_m, counts):
    place = RigidTransform.from_xyz_rpy("world", "s", [x_m, 0.5, 1.6], [0.0, 0.0, -1.0])
    clouds = scan("t", _TARGET, _BOARD), scan("s", place, _BOARD, seed=1)
    target, source = (prepare_gicp_cloud(each.lidar, each.points_m, FineConfig()) for each in clouds)
    pose = _TARGET.inverse() @ place
    found = find_residuals(find_overlap(target, source, pose), pose, np.zeros(2 * BIAS_COUNT))
    on_board = np.abs(_TARGET.rotate(found.normals)[:, 0]) > 0.95
    assert on_board.sum() > 100
    assert (np.median(found.weight[on_board]) > 0.1) == counts
    assert (np.mean(found.weight[on_board] == 0.0) > 0.9) == (not counts)
    assert np.median(found.weight[~on_board]) > 0.1


@pytest.mark.parametrize(("x_m", "counts"), [(-1.3, True), (1.3, False)], ids=["same side", "other side"])
def test_a_board_that_both_graze_has_two_sides(x_m, counts):
    """Beams meet it at 10 to 15 degrees, which its flat sides tell from none."""
    beside = RigidTransform.from_xyz_rpy("world", "t", [-1.3, -7.0, 1.5], [0.0, 0.0, 1.5])
    place = RigidTransform.from_xyz_rpy("world", "s", [x_m, -7.5, 1.6], [0.0, 0.0, 1.4])
    clouds = (
        scan(name, at, _BOARD, seed=seed, columns=1440) for seed, (name, at) in enumerate((("t", beside), ("s", place)))
    )
    target, source = (prepare_gicp_cloud(each.lidar, each.points_m, FineConfig()) for each in clouds)
    pose = beside.inverse() @ place
    found = find_residuals(find_overlap(target, source, pose), pose, np.zeros(2 * BIAS_COUNT))
    on_board = (np.abs(beside.rotate(found.normals)[:, 0]) > 0.95) & (found.weight > 0.05)
    assert (on_board.sum() > 50) == counts
    assert on_board.sum() > 50 or on_board.sum() < 10


def test_a_grazed_surface_has_no_side():
    points_m = np.array([[10.0, 0.0, 3.0], [10.0, 0.0, -3.0], [10.0, 0.0, 5.0], [10.0, 0.0, -5.0], [0.0, 0.0, 0.0]])
    normals = np.tile([0.0, 0.0, 1.0], (5, 1))
    assert sides_of(normals, points_m, np.zeros(5)).tolist() == [0.0, 0.0, 1.0, -1.0, 0.0]
    assert sides_of(normals, points_m, np.full(5, 0.9)).tolist() == [1.0, -1.0, 1.0, -1.0, 0.0]
