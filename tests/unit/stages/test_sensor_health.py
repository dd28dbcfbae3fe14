# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from multilica.config import HealthConfig
from multilica.simulate import simulate_snapshot
from multilica.simulate.sensors import RasterPattern, SpinningPattern
from multilica.snapshot import LidarScans, Scan
from multilica.stages.sensor_health import examine_sensor

CONFIG = HealthConfig()
NEAR_M = 1.0
PATTERNS = {"spinning": SpinningPattern(64, 900, (-25.0, 15.0)), "raster": RasterPattern(60, 300, 100.0, 25.0)}


def directions_of(pattern):
    return pattern.directions(0, np.random.default_rng(3))


def examined(directions, ranges_m):
    kept = np.isfinite(ranges_m)
    points_m = (directions[kept] * ranges_m[kept, None]).astype(np.float32)
    return examine_sensor(LidarScans("top", (Scan(points_m),)), NEAR_M, CONFIG)


def dirt(directions, patch, share=0.3, seed=1):
    """Ranges of a wall 10 m away, seen through dirt in the patch."""
    random = np.random.default_rng(seed)
    echo = np.where(random.random(len(directions)) < share, random.uniform(0.2, 0.95, len(directions)), np.nan)
    return np.where(patch, echo, 10.0)


@pytest.mark.parametrize("pattern", PATTERNS.values(), ids=PATTERNS)
def test_the_soiled_share_is_that_of_the_window(pattern):
    directions = directions_of(pattern)
    left = directions[:, 1] > 0.0
    health = examined(directions, dirt(directions, left))
    assert health.blockage_ratio == pytest.approx(0.5, abs=0.1)
    assert [reason.code for reason in health.reasons] == ["dirty"]
    assert health.reasons[0].value == health.blockage_ratio


@pytest.mark.parametrize("pattern", PATTERNS.values(), ids=PATTERNS)
def test_the_vehicles_own_body_is_no_dirt(pattern):
    directions = directions_of(pattern)
    body = directions[:, 1] > 0.1
    roof_m = 0.08 / directions[:, 1].clip(0.1)
    noise_m = np.random.default_rng(5).normal(scale=0.015, size=len(directions))
    health = examined(directions, np.where(body, roof_m + noise_m, 10.0))
    assert health.near_share > 0.3
    assert (health.blockage_ratio, health.reasons) == (0.0, ())


def test_sky_is_no_dirt():
    directions = directions_of(PATTERNS["spinning"])
    assert examined(directions, np.where(directions[:, 2] > 0.0, np.nan, 10.0)).reasons == ()


def test_strays_between_returns_are_no_dirt():
    directions = directions_of(PATTERNS["spinning"])
    random = np.random.default_rng(2)
    stray = random.random(len(directions)) < 0.1
    assert examined(directions, np.where(stray, random.uniform(0.3, 0.9, len(directions)), 10.0)).blockage_ratio == 0.0


def test_a_speck_smaller_than_a_block_does_not_count():
    directions = directions_of(PATTERNS["spinning"])
    speck = np.linalg.norm(directions - [1.0, 0.0, 0.0], axis=1) < np.deg2rad(3.0)
    assert examined(directions, dirt(directions, speck)).blockage_ratio == 0.0


@pytest.mark.parametrize("points", [np.empty((0, 3)), np.zeros((50, 3)), np.full((50, 3), np.nan)])
def test_a_dead_sensor_is_reported(points):
    health = examine_sensor(LidarScans("top", (Scan(points),)), NEAR_M, CONFIG)
    assert health.returns == 0
    assert [reason.code for reason in health.reasons] == ["dead"]


@pytest.mark.parametrize("rig", ["edgar", "sides"])
def test_only_the_dirty_lidar_of_a_rig_is_reported(rig):
    simulation = simulate_snapshot(rig, "street", 11, frames=1, disturbances=("dirty:left", "rain"), sensors="ideal")
    lidars = simulation.snapshot.lidars
    dirty = [lidar.name for lidar in lidars if examine_sensor(lidar, NEAR_M, CONFIG).reasons]
    assert dirty == ["left"]
