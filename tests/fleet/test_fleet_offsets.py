# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from multilica.errors import UsageError
from multilica.extrinsics import Extrinsics
from multilica.fleet.drift.drift import find_offsets
from multilica.geometry import RigidTransform
from tests.fleet.made_series import MOUNTED, Motion, made_fleet, made_vehicle, moved_mounting

_NOMINAL = Extrinsics("top", MOUNTED)
_RIG = ("left", "right")
_OFF = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.04])


def _rng(seed=1):
    return np.random.default_rng(seed)


def test_a_fleet_as_designed_has_no_offset():
    fleet = made_fleet(_rng(), 12, 6, lidars=_RIG, assembly=(0.002, 0.05))
    assert find_offsets(fleet, _NOMINAL) == []
    assert find_offsets(fleet) == []


def test_a_wrong_design_is_the_fleets():
    fleet = made_fleet(_rng(), 12, 6, lidars=_RIG, mounted=moved_mounting("left", _OFF))
    (offset,) = find_offsets(fleet, _NOMINAL)
    assert (offset.scope, offset.lidar, offset.vehicle, offset.vehicles) == ("fleet", "left", None, 12)
    np.testing.assert_allclose(offset.translation_m, _OFF[3:], atol=0.003)
    assert offset.sentence == "left is 40 mm and 0.00 deg off its nominal pose on all 12 vehicles."
    assert find_offsets(fleet) == []


def test_nominal_poses_of_other_names_are_refused():
    other = Extrinsics("base_link", {"lidar_left": RigidTransform.identity("base_link", "lidar_left")})
    with pytest.raises(UsageError, match="The nominal poses are of base_link, lidar_left; expected two or more"):
        find_offsets(made_fleet(_rng(), 3, 3, lidars=_RIG), other)
    assert find_offsets([], other) == []


@pytest.mark.parametrize("nominal", [_NOMINAL, None])
def test_one_vehicle_differs_from_its_fleet(nominal):
    odd = made_vehicle(_rng(5), 6, vehicle="v99", lidars=_RIG, mounted=moved_mounting("right", _OFF))
    (offset,) = find_offsets([*made_fleet(_rng(), 12, 6, lidars=_RIG), *odd], nominal)
    assert (offset.scope, offset.lidar, offset.vehicle) == ("vehicle", "right", "v99")
    np.testing.assert_allclose(offset.translation_m, _OFF[3:], atol=0.006)
    assert offset.sentence.startswith("v99: right is ")
    assert offset.sentence.endswith("off the fleet of 13 vehicles.")


def test_a_wrong_design_and_an_odd_vehicle_are_both_named():
    wrong = moved_mounting("left", _OFF)
    odd = made_vehicle(_rng(5), 6, vehicle="v99", lidars=("left",))
    found = find_offsets([*made_fleet(_rng(), 12, 6, lidars=("left",), mounted=wrong), *odd], _NOMINAL)
    assert [(offset.scope, offset.vehicle) for offset in found] == [("fleet", None), ("vehicle", "v99")]
    np.testing.assert_allclose(found[1].translation_m, -_OFF[3:], atol=0.006)


def test_a_vehicle_counts_as_it_is_since_its_last_jump():
    moved = made_vehicle(_rng(5), 12, vehicle="v99", motions={"left": Motion(_OFF, index=8)})
    back = made_vehicle(
        _rng(6), 12, vehicle="v98", mounted=moved_mounting("left", _OFF), motions={"left": Motion(-_OFF, index=4)}
    )
    found = find_offsets([*made_fleet(_rng(), 12, 6), *moved, *back], _NOMINAL)
    assert [(offset.scope, offset.vehicle) for offset in found] == [("vehicle", "v99")]


def test_two_vehicles_do_not_tell_design_from_assembly():
    wrong = moved_mounting("left", _OFF)
    pair = made_fleet(_rng(), 2, 8, lidars=_RIG, mounted=wrong)
    found = find_offsets(pair, _NOMINAL)
    assert [(offset.scope, offset.lidar, offset.vehicle) for offset in found] == [
        ("fleet or vehicle", "left", "f000"),
        ("fleet or vehicle", "left", "f001"),
    ]
    assert found[0].sentence.endswith("off its nominal pose.")
    assert find_offsets(pair) == []
