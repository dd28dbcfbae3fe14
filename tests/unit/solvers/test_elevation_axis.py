# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica.simulate import simulate_snapshot
from multilica.solvers.elevation_axis import find_elevation_axis
from tests.opencalib import DATA, MISSING, read_clouds

_TURNS = Rotation.random(3, random_state=1).as_matrix()
_ROSETTE = "livox"


def _deg_off(found, expected):
    return np.rad2deg(np.arccos(min(1.0, abs(float(found @ expected)))))


@pytest.mark.parametrize("rig", ["corners", "edgar", "helipr", "narrow4", "ring6"])
def test_the_axis_of_rows_of_beams_is_found(rig):
    """Of rings and rasters in any frame, also if the driver rounds to millimetres."""
    for lidar in simulate_snapshot(rig, "street", 1, frames=1).snapshot.lidars:
        points_m = lidar.points_m
        assert np.array_equal(find_elevation_axis(points_m), [0.0, 0.0, 1.0]), lidar.name
        for turn in _TURNS if lidar.name != _ROSETTE else []:
            turned_m = points_m @ turn.T
            assert _deg_off(find_elevation_axis(turned_m), turn[:, 2]) < 0.001, lidar.name
            assert _deg_off(find_elevation_axis(np.round(turned_m, 3)), turn[:, 2]) < 0.2, lidar.name


def test_the_axis_of_a_rosette_is_one_of_the_frame():
    """Of those across the way ahead, the one along which points rise least."""
    points_m = simulate_snapshot("helipr", "street", 1, frames=1).snapshot[_ROSETTE].points_m
    for turns in range(3):
        axis = find_elevation_axis(np.roll(points_m, turns, axis=1))
        assert np.count_nonzero(axis) == 1
        assert axis[turns] == 0.0, "the LiDAR looks along x, which is there now"


def test_the_line_of_sight_of_a_narrow_rosette_is_no_axis():
    """All its steps are nearly across the way ahead."""
    rng = np.random.default_rng(0)
    beams = np.column_stack([np.ones(5000), *rng.uniform(-0.05, 0.05, (2, 5000))])
    assert find_elevation_axis(20.0 * beams)[0] == 0.0


@pytest.mark.skipif(not DATA.is_dir(), reason=MISSING)
def test_the_axis_of_real_scans_is_found():
    for name, points_m in read_clouds().items():
        for turn in (np.eye(3), *_TURNS):
            assert _deg_off(find_elevation_axis(points_m @ turn.T), turn[:, 2]) < 0.001, name


@pytest.mark.parametrize(
    "points_m",
    [np.empty((0, 3)), np.zeros((9, 3)), np.full((9, 3), np.nan), np.outer(np.arange(1, 9), [1.0, 0.0, 0.0])],
    ids=["none", "at the origin", "no numbers", "one beam"],
)
def test_few_beams_leave_an_axis_of_the_frame(points_m):
    assert np.count_nonzero(find_elevation_axis(points_m)) == 1
