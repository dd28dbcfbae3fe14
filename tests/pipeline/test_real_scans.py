# SPDX-License-Identifier: Apache-2.0
import pytest
from scipy.spatial.transform import Rotation

from multilica.pipeline import calibrate
from tests.opencalib import CONFIG, DATA, MISSING, SOURCES, is_true, read_clouds, turned_snapshot, unturned
from tests.selection import some_of

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not DATA.is_dir(), reason=MISSING)]


@pytest.fixture(scope="module")
def clouds():
    return read_clouds()


@pytest.fixture(scope="module")
def result(clouds):
    return calibrate(turned_snapshot(clouds, {}), CONFIG)


def test_both_sides_are_found(result):
    assert result.status == "complete"
    for name in SOURCES:
        assert is_true(result[name].T_target_source), (name, result[name].T_target_source)


@pytest.mark.parametrize("seed", some_of([1, 2, 3], 1))
@pytest.mark.in_turn
def test_both_sides_are_found_from_any_orientation(clouds, seed):
    rotations = {name: Rotation.random(random_state=seed).as_matrix() for name in SOURCES}
    result = calibrate(turned_snapshot(clouds, rotations), CONFIG)
    assert result.status == "complete"
    for name in SOURCES:
        found = unturned(result[name].T_target_source, rotations[name])
        assert is_true(found), (name, found.xyz_m, found.rpy_deg)


@pytest.mark.nightly
def test_two_runs_give_the_same_bits(clouds, result):
    again = calibrate(turned_snapshot(clouds, {}), CONFIG)
    for name in SOURCES:
        assert again[name].T_target_source.matrix.tobytes() == result[name].T_target_source.matrix.tobytes()
        assert again[name].fitness == result[name].fitness
