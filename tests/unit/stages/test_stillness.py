# SPDX-License-Identifier: Apache-2.0
"""Standing still, on rooms whose walls beams meet at exact ranges."""

from __future__ import annotations

import numpy as np
import pytest

from multilica.config import PreprocessConfig, StillnessConfig
from multilica.geometry import Z_AXIS, FloatArray, RigidTransform
from multilica.snapshot import LidarScans, Scan
from multilica.stages import stillness
from multilica.stages.preprocess import _grid, drop_moving, preprocess
from multilica.stages.stillness import Motion, Structure, detect_motion, explain_motion, whole_frames

_ROOM_M = (9.0, 6.0, 4.0)
_CORRIDOR_M = (np.inf, 3.0, 2.5)
_CONFIG = StillnessConfig()


def _beams(phase: float) -> FloatArray:
    azimuth, elevation = np.meshgrid(
        np.deg2rad(np.arange(0.0, 360.0, 1.5) + phase), np.deg2rad(np.arange(-39.0, 40.0, 2.0)), indexing="ij"
    )
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1).reshape(-1, 3)


def _scan(half_sizes_m: tuple[float, float, float], seed: int, pose: RigidTransform | None = None) -> Scan:
    """Scan the walls of a room from a pose near its middle, with range noise."""
    rng = np.random.default_rng(seed)
    pose = pose or RigidTransform.identity("room", "lidar")
    beams = _beams(rng.uniform(0.0, 1.5))
    turned = pose.rotate(beams)
    wall_m = np.sign(turned) * np.array(half_sizes_m) - pose.xyz_m
    range_m = np.min(wall_m / turned, axis=1)
    range_m = range_m + rng.normal(scale=0.02, size=len(range_m))
    returned = range_m < 60.0
    return Scan((beams * range_m[:, None])[returned].astype(np.float32))


def _pose(xyz_m: tuple[float, float, float], yaw_deg: float = 0.0) -> RigidTransform:
    return RigidTransform.from_xyz_rpy("room", "lidar", xyz_m, (0.0, 0.0, np.deg2rad(yaw_deg)))


def _drive(half_sizes_m: tuple[float, float, float], step_m: float, step_deg: float = 0.0) -> list[Scan]:
    return [_scan(half_sizes_m, frame, _pose((frame * step_m, 0.0, 0.0), frame * step_deg)) for frame in range(5)]


def test_noise_is_no_motion() -> None:
    motion = detect_motion(_drive(_ROOM_M, 0.0), _CONFIG)
    assert motion.observable
    assert not motion.moving
    assert motion.shift_m < 0.01


def test_driving_is_measured() -> None:
    motion = detect_motion(_drive(_ROOM_M, 0.3), _CONFIG)
    assert motion.moving
    assert motion.shift_m == pytest.approx(1.2, abs=0.03)
    assert motion.turn_rad == pytest.approx(0.0, abs=0.005)
    assert motion.significance > 100.0


@pytest.mark.parametrize("step_m", [1.4, 2.0])
def test_driving_across_a_bare_room_is_measured(step_m: float) -> None:
    motion = detect_motion(_drive(_ROOM_M, step_m), _CONFIG)
    assert motion.moving
    assert not motion.at_least
    assert motion.shift_m == pytest.approx(4 * step_m, abs=0.05)


@pytest.mark.slow
def test_a_lidar_that_jumps_out_of_sight_moves_at_least_a_bit() -> None:
    here, there = _scan(_ROOM_M, 1), _scan((30.0, 2.5, 1.5), 2, _pose((0.0, 0.0, 0.0), 40.0))
    motion = detect_motion([here, there], _CONFIG)
    assert motion.moving
    assert motion.at_least
    assert "left by at least 0.20 m" in explain_motion({"left": motion})


def test_frames_that_are_alike_are_not_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stillness, "_TRACKED_BELOW", 2.0)
    monkeypatch.setattr(stillness, "_find_step", lambda *_: None)
    motion = detect_motion(_drive(_ROOM_M, 0.0), _CONFIG)
    assert not motion.moving
    assert motion.shift_m < 0.01
    lost = detect_motion(_drive(_ROOM_M, 3.0), _CONFIG)
    assert (lost.moving, lost.observable, lost.at_least) == (True, True, True)


def test_turning_on_the_spot_is_measured() -> None:
    motion = detect_motion(_drive(_ROOM_M, 0.0, 0.5), _CONFIG)
    assert motion.moving
    assert np.rad2deg(motion.turn_rad) == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("step_m", [0.0, 0.3])
def test_along_a_corridor_motion_is_not_observable(step_m: float) -> None:
    motion = detect_motion(_drive(_CORRIDOR_M, step_m), _CONFIG)
    assert not motion.observable
    assert not motion.moving


def test_the_limit_of_the_shift_is_configured() -> None:
    scans = _drive(_ROOM_M, 0.03)
    assert detect_motion(scans, _CONFIG).moving
    assert not detect_motion(scans, StillnessConfig(max_shift_m=0.2)).moving


def test_two_frames_are_compared_however_many_points_they_have() -> None:
    """Of two stops of a drive, one may be in a garage."""
    counts = (900, 200), (900, 0), (0, 0), (900, 200, 800), (0, 900, 100)
    whole = [whole_frames([Scan(np.ones((count, 3), np.float32)) for count in each]) for each in counts]
    assert whole == [[0, 1], [0], [], [0, 2], [1, 2]]


@pytest.mark.parametrize("index", [0, 2, 4])
@pytest.mark.parametrize("share", [0.0, 0.3])
def test_frames_that_are_not_whole_hide_no_motion(index: int, share: float) -> None:
    """A driver that starts sends frames without points, or parts of one; NaN counts as no point."""
    for step_m in (0.0, 0.3):
        scans = _drive(_ROOM_M, step_m)
        points_m = scans[index].points_m.copy()
        azimuth = np.arctan2(points_m[:, 1], points_m[:, 0])
        points_m[np.abs(azimuth) > share * np.pi] = np.nan
        scans[index] = Scan(points_m)
        found = detect_motion(scans, _CONFIG)
        assert found.observable
        assert found.moving == (step_m > 0.0)
        assert not found.at_least


@pytest.mark.parametrize("count", [0, 1])
def test_a_single_frame_shows_no_motion(count: int) -> None:
    scans = _drive(_ROOM_M, 0.3)[:count]
    assert detect_motion(scans, _CONFIG) == Motion(0.0, 0.0, 0.0, observable=False, moving=False, at_least=False)
    kept, dropped_m = drop_moving(scans, _CONFIG)
    assert len(kept) == count
    assert len(dropped_m) == 0


def test_frames_without_returns_show_no_motion() -> None:
    scans = [Scan(np.empty((0, 3), dtype=np.float32)), _scan(_ROOM_M, 1), Scan(np.full((9, 3), np.nan))]
    assert not detect_motion(scans, _CONFIG).observable
    kept, dropped_m = drop_moving(scans, _CONFIG)
    assert [len(scan.points_m) for scan in kept] == [0, len(scans[1].points_m), 9]
    assert len(dropped_m) == 0


def test_the_refusal_says_how_far_each_lidar_moved() -> None:
    still, moving = Motion(observable=True), Motion(0.31, 0.0017, 40.0, observable=True, moving=True)
    sentence = explain_motion({"left": moving, "right": moving, "top": still, "blind": Motion()}, "drive.mcap")
    assert sentence.startswith("The vehicle moves in drive.mcap: left by 0.31 m and 0.1 deg, right by 0.31 m")
    assert "2 of 3 LiDARs that can detect motion" in sentence
    assert "--start" in sentence
    assert explain_motion({"left": moving, "right": still}) == ""
    assert explain_motion({"blind": Motion()}) == ""


def test_a_lidar_alone_needs_more_significance() -> None:
    weak, strong = (Motion(0.16, 0.04, significance, observable=True, moving=True) for significance in (18.0, 40.0))
    assert explain_motion({"livox": weak, "top": Motion()}) == ""
    assert "1 of 1 LiDARs that can detect motion" in explain_motion({"livox": strong, "top": Motion()})
    assert explain_motion({"livox": weak, "top": weak}) != ""
    assert explain_motion({"alone": weak}) != ""


def _with_visitor(
    scan: Scan, azimuth_deg: float, range_m: float = 3.0
) -> tuple[Scan, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    """Add a person as wide as 20 degrees at 3 m; also return which returns are on the person."""
    azimuth = np.rad2deg(np.arctan2(scan.points_m[:, 1], scan.points_m[:, 0]))
    on_person = np.abs(azimuth - azimuth_deg) < 10.0 * 3.0 / range_m
    points_m = scan.points_m.copy()
    points_m[on_person] *= range_m / np.linalg.norm(points_m[on_person], axis=1, keepdims=True)
    return Scan(points_m, intensity=on_person.astype(np.float32), rings=on_person), on_person


def test_a_room_loses_hardly_anything() -> None:
    scans = _drive(_ROOM_M, 0.0)
    _, dropped_m = drop_moving(scans, _CONFIG)
    assert len(dropped_m) < 0.01 * sum(len(scan.points_m) for scan in scans)


def test_pedestrians_are_dropped_with_intensities_and_rings() -> None:
    visited = [_with_visitor(scan, 25.0 * frame - 50.0) for frame, scan in enumerate(_drive(_ROOM_M, 0.0))]
    kept, dropped_m = drop_moving([scan for scan, _ in visited], _CONFIG)
    on_people = sum(int(mask.sum()) for _, mask in visited)
    left = sum(int(scan.intensity.sum()) for scan in kept if scan.intensity is not None)
    assert left < 0.2 * on_people
    assert all(np.array_equal(scan.rings, scan.intensity) for scan in kept)
    assert np.allclose(np.linalg.norm(dropped_m, axis=1), 3.0, atol=1e-3)


def test_pedestrians_before_the_sky_are_dropped() -> None:
    """No beam returns from where they were."""
    visited = [_with_visitor(scan, 25.0 * frame - 50.0) for frame, scan in enumerate(_drive(_ROOM_M, 0.0))]
    under_sky = [scan.selected(mask | (scan.points_m[:, 2] < 0.0)) for scan, mask in visited]
    kept, _ = drop_moving(under_sky, _CONFIG)
    before, after = (
        sum(int(np.sum(scan.intensity[scan.points_m[:, 2] > 0.2])) for scan in scans if scan.intensity is not None)
        for scans in (under_sky, kept)
    )
    assert before > 500
    assert after < 0.1 * before


@pytest.mark.parametrize("way_m", [(3.0, 4.0, 5.0), (5.0, 4.0, 3.0)], ids=["away", "towards"])
def test_who_hides_the_farthest_place_leaves_nothing_there(way_m) -> None:
    """No beam passes beyond the farthest place, which the person hides in all other frames."""
    scans = _drive(_ROOM_M, 0.0)[: len(way_m)]
    visited = [_with_visitor(scan, 0.0, range_m) for range_m, scan in zip(way_m, scans, strict=True)]
    kept, _ = drop_moving([scan for scan, _ in visited], _CONFIG)
    for scan, (_, on_person) in zip(kept, visited, strict=True):
        assert np.sum(scan.intensity) < 0.1 * np.sum(on_person)
        assert np.count_nonzero(scan.intensity == 0.0) > 0.9 * np.count_nonzero(~on_person)


def test_what_one_frame_alone_shows_is_not_hidden() -> None:
    """Somebody walks off ahead, and only the last frame has returns from behind the LiDAR."""
    visited = [
        _with_visitor(scan, 0.0, range_m)[0]
        for range_m, scan in zip((3.0, 4.0, 5.0), _drive(_ROOM_M, 0.0)[:3], strict=True)
    ]
    scans = [*(scan.selected(scan.points_m[:, 0] > 0.0) for scan in visited[:2]), visited[2]]
    kept, _ = drop_moving(scans, _CONFIG)
    behind, left = (np.count_nonzero(scan.points_m[:, 0] < -0.5) for scan in (scans[2], kept[2]))
    assert left > 0.98 * behind


def test_frames_of_different_directions_prove_nothing() -> None:
    halves = [
        scan.selected((scan.points_m[:, 1] > 0.0) == (frame % 2 == 0))
        for frame, scan in enumerate(_drive(_ROOM_M, 0.0))
    ]
    _, dropped_m = drop_moving(halves, _CONFIG)
    assert len(dropped_m) < 0.01 * sum(len(scan.points_m) for scan in halves)


def test_a_standing_person_is_kept() -> None:
    visited = [_with_visitor(scan, 0.0) for scan in _drive(_ROOM_M, 0.0)]
    _, dropped_m = drop_moving([scan for scan, _ in visited], _CONFIG)
    assert len(dropped_m) < 0.05 * sum(int(mask.sum()) for _, mask in visited)


def _ahead(scan: Scan) -> Scan:
    """Return what a LiDAR with a wide and low field of view sees."""
    x_m, y_m, z_m = scan.points_m.T
    return scan.selected((x_m > 0.7 * np.abs(y_m)) & (np.abs(z_m) < 0.3 * x_m))


@pytest.mark.parametrize("turns", [1, 2])
def test_any_axis_may_be_up(turns: int) -> None:
    """Cells about the axis along which a LiDAR looks would be narrower than the distance of its beams."""
    ahead = [_ahead(scan) for scan in _drive(_ROOM_M, 0.0)]
    visited = [_with_visitor(scan, 25.0 * frame - 50.0)[0] for frame, scan in enumerate(ahead)]
    rolled = [Scan(np.roll(scan.points_m, turns, axis=1)) for scan in visited]
    upright, other = (
        preprocess(LidarScans("top", tuple(scans)), PreprocessConfig(), _CONFIG) for scans in (visited, rolled)
    )
    assert np.array_equal(other.elevation_axis, np.roll(Z_AXIS, turns))
    assert len(upright.dropped_m["moving"]) > 100
    np.testing.assert_array_equal(np.roll(upright.dropped_m["moving"], turns, axis=1), other.dropped_m["moving"])


def test_cells_of_directions_are_as_wide_as_they_are_high():
    yaw, pitch = (each.ravel() for each in np.meshgrid(np.arange(0.0, 2.0 * np.pi, 0.01), np.arange(-0.3, 0.2, 0.01)))
    points_m = 10.0 * np.stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)], axis=1)
    grid = _grid([(points_m, np.full(len(points_m), 10.0))], Z_AXIS)
    cells = grid.cells(points_m, np.full(len(points_m), 10.0))
    for angle, index, count in ((yaw, cells % grid.columns, grid.columns), (pitch, cells // grid.columns, grid.rows)):
        assert index.max() == count - 1
        for cell in range(0, count, 7):
            assert np.ptp(angle[index == cell]) <= grid.cell_rad
    assert grid.cell_rad < 0.03


def test_what_is_near_or_far_or_dense_is_left_out() -> None:
    """The body of the vehicle moves with the LiDAR, and beams far off are too sparse."""
    along_m = np.arange(0.125, 60.0, 0.25)
    kept_m = stillness._surroundings(Scan(np.outer(along_m, [0.0, 1.0, 0.0]).astype(np.float32)))[:, 1]
    assert 2.5 < kept_m.min() < 3.0
    assert 39.5 < kept_m.max() < 40.0
    assert len(kept_m) == 2 * (40.0 - 2.5)


@pytest.fixture(scope="module")
def frames() -> list[Structure]:
    """Frames of a hall, from where a LiDAR is, and from 3.2 m aside turned by 50 degrees, out of the reach of GICP."""
    poses = (_pose((0.0, -1.6, 0.0)), _pose((0.0, 1.6, 0.0), 50.0))
    return [Structure(stillness._surroundings(_scan((5.0, 12.0, 4.0), seed, pose))) for seed, pose in enumerate(poses)]


_TURNED = _pose((0.0, 0.0, 0.0), 50.0).matrix


def test_starts_are_those_that_explain_the_most(frames: list[Structure]) -> None:
    starts = stillness._starts(*frames, _TURNED, np.array([0.0, 1.0, 0.0]))
    shifts_m = [start[:3, 3] for start in starts]
    assert len(starts) == 4
    np.testing.assert_allclose(shifts_m[0], [0.0, 3.2, 0.0], atol=0.01)
    assert all(np.array_equal(start[:3, :3], _TURNED[:3, :3]) for start in starts)


def test_a_step_beyond_reach_is_found_where_the_last_one_turned(
    frames: list[Structure], monkeypatch: pytest.MonkeyPatch
) -> None:
    directions, starts = [], stillness._starts
    monkeypatch.setattr(stillness, "_starts", lambda *given: directions.append(given[-1]) or starts(*given))
    near = stillness.register_frames(*frames, _TURNED)
    assert np.linalg.norm(near.T_target_source[:3, 3]) < 2.0
    found = stillness._find_step(*frames, _TURNED)
    assert found is not None
    np.testing.assert_allclose(found.T_target_source[:3, 3], [0.0, 3.2, 0.0], atol=0.05)
    np.testing.assert_allclose(np.abs(directions), [[0.0, 1.0, 0.0]], atol=0.05)
