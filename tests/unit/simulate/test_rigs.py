# SPDX-License-Identifier: Apache-2.0
"""Where the LiDARs of large rigs sit, and what they see of each other's view."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from multilica.simulate import RIGS, SCENES
from multilica.simulate.shapes.mesh import merged, reaches_into
from tests.selection import some_of


def distances_m(rig: str) -> list[float]:
    poses = [mount.T_base_lidar.xyz_m for mount in RIGS[rig].mounts]
    return [float(np.linalg.norm(first - second)) for first, second in combinations(poses, 2)]


def test_sectors_stand_at_even_angles():
    for count in (8, 20):
        mounts = RIGS[f"sectors{count}"].mounts
        assert [mount.rpy_deg[2] for mount in mounts] == pytest.approx(
            [360.0 / count * index for index in range(count)]
        )
        assert all(mount.sensor.pattern.horizontal_fov_deg == 120.0 for mount in mounts)


def test_a_ring_is_up_to_three_metres_across():
    assert 3.0 < max(distances_m("ring6")) < 3.2
    assert all(mount.sensor.pattern.horizontal_fov_deg == 360.0 for mount in RIGS["ring6"].mounts)


def test_a_truck_has_three_kinds_far_apart():
    assert len({mount.sensor for mount in RIGS["truck"].mounts}) == 3
    assert len(RIGS["truck"].mounts) == 7
    assert min(distances_m("truck")) > 2.5
    assert 11.5 < max(distances_m("truck")) < 12.0


@pytest.mark.parametrize("rig", sorted(RIGS))
def test_no_lidar_sits_inside_the_body(rig):
    body, size_m = RIGS[rig].body, np.full(3, 0.03)
    for mount in RIGS[rig].mounts:
        assert not reaches_into(body, np.array(mount.xyz_m) - size_m, np.array(mount.xyz_m) + size_m), mount.name


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize("scene", sorted({*SCENES} - {"fence_field"}))
def test_scenes_make_room(scene):
    for seed in some_of(range(3), 1):
        built = SCENES[scene](np.random.default_rng(seed))
        for rig in ("ring6", "sectors20", "truck"):
            low_m, high_m = RIGS[rig].room_m
            cleared = built.with_room_for(low_m, high_m)
            in_base = merged(cleared.parts).transformed(cleared.T_world_base.inverse())
            assert not reaches_into(in_base, low_m, high_m), rig


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize("scene", sorted(SCENES))
def test_room_for_a_car_changes_nothing(scene):
    for seed in some_of(range(5), 1):
        built = SCENES[scene](np.random.default_rng(seed))
        for rig in ("blind", "chain", "edgar", "helipr", "sides"):
            assert len(built.with_room_for(*RIGS[rig].room_m).parts) == len(built.parts)
