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


def test_a_grazed_surface_has_no_side():
    points_m = np.array([[10.0, 0.0, 3.0], [10.0, 0.0, -3.0], [10.0, 0.0, 5.0], [10.0, 0.0, -5.0], [0.0, 0.0, 0.0]])
    assert sides_of(np.tile([0.0, 0.0, 1.0], (5, 1)), points_m).tolist() == [0.0, 0.0, 1.0, -1.0, 0.0]
