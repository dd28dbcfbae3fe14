# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica.pipeline import calibrate
from tests.opencalib import CONFIG, DATA, MISSING, SOURCES, is_true, read_clouds, turned_snapshot, unturned

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not DATA.is_dir(), reason=MISSING)]


@pytest.fixture(scope="module")
def clouds():
    return read_clouds()


@pytest.mark.parametrize("seed", [None, 1, 2, 3])
def test_both_sides_are_found_from_any_orientation(clouds, seed):
    rotations = {}
    if seed is not None:
        rotations = {name: Rotation.random(random_state=seed).as_matrix() for name in SOURCES}
    result = calibrate(turned_snapshot(clouds, rotations), CONFIG)
    assert result.status == "complete"
    for name in SOURCES:
        found = unturned(result[name].T_target_source, rotations.get(name, np.eye(3)))
        assert is_true(found), (name, found.xyz_m, found.rpy_deg)


def test_two_runs_give_the_same_bits(clouds):
    snapshot = turned_snapshot(clouds, {})
    first, second = (calibrate(snapshot, CONFIG) for _ in range(2))
    for name in SOURCES:
        assert first[name].T_target_source.matrix.tobytes() == second[name].T_target_source.matrix.tobytes()
        assert first[name].fitness == second[name].fitness
