# SPDX-License-Identifier: Apache-2.0
"""Which of the planes about the axes of a LiDAR may be the ground."""

from types import SimpleNamespace

import numpy as np
import pytest

from multilica.config import CalibrationConfig, with_overrides
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.orchestration import movable
from multilica.orchestration.rig import ground_under
from multilica.snapshot import LidarScans, Snapshot
from multilica.stages import ground
from multilica.stages.ground import find_levels

_AXES = "z", "-z", "x", "-x", "y", "-y"
_UP = np.array([0.0, 0.0, 1.0])
_POINTS_M = np.random.default_rng(0).uniform(-9.0, 9.0, (4_000, 3))
_CONFIG = CalibrationConfig()


def _levels(monkeypatch, scores, normals=None, least_score=-np.inf):
    """Find levels where the planes about some axes have those scores."""
    asked = iter(_AXES)

    def find(*_):
        axis = next(asked)
        normal = (normals or {}).get(axis, _UP)
        made = SimpleNamespace(normal=normal, offset_m=2.0, score=scores.get(axis), cells=500)
        return made if axis in scores else None

    monkeypatch.setattr(ground, "_find_surface", find)
    return find_levels("top", {"top": _POINTS_M}, {}, _CONFIG, least_score)


def test_little_ground_is_none_about_any_axis(monkeypatch):
    assert len(_levels(monkeypatch, {"z": 10.0, "y": 9.0, "-x": 11.0}, least_score=10.0)) == 2


@pytest.mark.parametrize(
    ("scores", "likely"),
    [
        ({}, []),
        ({"z": 10.0, "y": 100.0}, ["z", "y"]),
        ({"z": 100.0, "y": 51.0, "-x": 49.0}, ["z", "y"]),
        ({"z": 100.0, "-z": 1.0, "-y": 1.0}, ["z", "-z"]),
        ({"x": 60.0, "-x": 1.0, "y": 100.0, "-z": 80.0}, ["y", "-z", "x", "-x"]),
    ],
)
def test_the_ground_may_be_about_several_axes(monkeypatch, scores, likely):
    ups = {tuple(up[2]): axis for up, axis in zip(ground._UPS, _AXES, strict=True)}
    found = _levels(monkeypatch, scores)
    assert [ups[tuple(np.round(level.rotation[2], 6) + 0.0)] for level in found] == likely
    assert all(level.xyz_m == pytest.approx([0.0, 0.0, 2.0]) for level in found)


@pytest.mark.parametrize(("height_m", "is_ground"), [(0.9, True), (-0.9, False)])
def test_a_surface_above_the_rig_is_no_ground(monkeypatch, height_m, is_ground):
    """The fit may raise a plane that RANSAC found below."""
    made = SimpleNamespace(normal=_UP, offset_m=height_m + 0.1, below=0.0, score=9.0)
    monkeypatch.setattr(ground, "_planes", lambda *_: iter([(_UP, 0.1)]))
    monkeypatch.setattr(ground, "fit_surface", lambda *_: made)
    found = ground._find_surface(_POINTS_M, 0.1 * _UP, _CONFIG, None, np.zeros(2))
    assert found is (made if is_ground else None)


def test_a_slope_between_two_axes_is_one_ground(monkeypatch):
    slope = np.array([np.sqrt(0.5), 0.0, np.sqrt(0.5)])
    about_x = ground._UPS[_AXES.index("x")] @ slope
    (level,) = _levels(monkeypatch, {"z": 50.0, "x": 60.0}, {"z": slope, "x": about_x})
    assert level.rotation[2] == pytest.approx(slope)


@pytest.mark.parametrize(
    ("about_z", "others", "taken"),
    [("about z", ["other"], "about z"), (None, ["likeliest", "other"], "likeliest"), (None, [], None)],
)
def test_pictures_are_upright_whichever_axis_is_up(monkeypatch, about_z, others, taken):
    monkeypatch.setattr(ground, "estimate_level_about_z", lambda *_: about_z)
    monkeypatch.setattr(ground, "find_levels", lambda *_: others)
    assert ground.estimate_level("top", {"top": _POINTS_M}, {}, _CONFIG) == taken


def test_objects_are_movable_about_each_level(monkeypatch):
    levels = [RigidTransform("level", "t", np.diag([1.0, sign, sign, 1.0])) for sign in (1.0, -1.0)]
    side = SimpleNamespace(side=SimpleNamespace(cloud=SimpleNamespace(points_m=_POINTS_M)))
    cloud = SimpleNamespace(points_m=_POINTS_M)
    state = SimpleNamespace(target="t", clouds={"t": cloud}, lidars={"t": side}, config=_CONFIG, level=None)
    monkeypatch.setattr(movable, "find_levels", lambda *_: levels)
    cells = movable._movable_cells(state, {"t": RigidTransform.identity("t", "t")}, np.empty((0, 3)))
    assert [part.rotation[2, 2] for part in cells.parts] == [1.0, -1.0]
    assert state.level is levels[0]


def test_the_rig_file_tells_the_ground_from_the_ceiling():
    """Seen upside down, the ceiling is the ground about z, and there is more of it."""
    rng = np.random.default_rng(1)
    planes = ((1.3, 9_000, 12.0), (-1.9, 6_000, 10.0))
    points_m = np.concatenate(
        [np.column_stack([rng.uniform(-r, r, (n, 2)), rng.normal(z, 0.005, n)]) for z, n, r in planes]
    )
    drawn = RigidTransform.from_xyz_rpy("base", "t", [0.4, 0.1, 1.8], [np.pi + 0.02, 0.0, 0.3])
    seen_m = RigidTransform.from_xyz_rpy("base", "t", [0.0, 0.0, 0.0], [np.pi, 0.0, 0.3]).inverse().apply(points_m)
    poses, rig = {"t": RigidTransform.identity("t", "t")}, Extrinsics("base", {"t": drawn})
    snapshot, config = Snapshot((LidarScans("t", ()),)), with_overrides(_CONFIG, ["ground.frame=base"])
    assert ground_under(snapshot, "t", {"t": seen_m}, poses, config, None)[0].offset_m == pytest.approx(1.3, abs=0.01)
    found, reason = ground_under(snapshot, "t", {"t": seen_m}, poses, config, rig)
    assert found is not None, reason
    assert found.offset_m == pytest.approx(1.9, abs=0.01)
    assert found.T_base_target.rotation[2] @ drawn.rotation[2] > 0.999
    assert found.T_base_target.xyz_m[:2] == pytest.approx([0.4, 0.1])
    assert found.T_base_target_rig.matrix == pytest.approx(drawn.matrix)


def test_a_target_upside_down_has_its_pose_over_the_ground():
    rng = np.random.default_rng(1)
    flat_m = np.column_stack([rng.uniform(-12.0, 12.0, (6_000, 2)), rng.normal(1.9, 0.005, 6_000)])
    poses = {"t": RigidTransform.identity("t", "t")}
    found, reason = ground_under(Snapshot(()), "t", {"t": flat_m}, poses, _CONFIG, None)
    assert found is not None, reason
    assert found.offset_m == pytest.approx(1.9, abs=0.01)
    assert found.normal == pytest.approx([0.0, 0.0, -1.0], abs=1e-3)
    assert found.T_base_target.rotation[2] == pytest.approx(found.normal)


@pytest.mark.parametrize("seed", range(5))
def test_the_ground_of_a_tunnel_is_found_beside_its_walls(seed):
    """Nine of ten points are on the walls, and the ground near the vehicle is not seen."""
    rng = np.random.default_rng(seed)
    along, up = rng.uniform([-15.0, -0.5], [15.0, 4.0], (2700, 2)).T
    walls_m = np.column_stack([along, rng.choice([-4.0, 4.0], 2700), up])
    ground_m = np.column_stack([rng.uniform(7.0, 15.0, 300), rng.uniform(-4.0, 4.0, 300), np.full(300, -2.0)])
    ground_m[::2, 0] *= -1.0
    points_m = np.concatenate([walls_m, ground_m]) + rng.normal(scale=0.01, size=(3000, 3))
    first, *_ = find_levels("top", {"top": points_m}, {}, CalibrationConfig())
    assert first.rotation[2, 2] > 0.999
