# SPDX-License-Identifier: Apache-2.0
"""Series of poses with known scatter and known changes, as numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from multilica.fleet.lidar_series import LidarSeries
from multilica.geometry import RigidTransform

DAY_NS = 86_400_000_000_000
START_NS = 1_767_225_600_000_000_000  # 2026-01-01
YEAR_NS = 365 * DAY_NS
MOUNTED = {
    "left": RigidTransform.from_xyz_rpy("top", "left", [1.2, 0.9, -0.8], [0.1, 0.2, 1.5]),
    "right": RigidTransform.from_xyz_rpy("top", "right", [1.1, -0.9, -0.7], [-0.1, 0.1, -1.4]),
    "rear": RigidTransform.from_xyz_rpy("top", "rear", [-2.5, 0.1, -1.0], [0.0, 0.3, 3.0]),
}


@dataclass(frozen=True)
class Noise:
    """How poses scatter, and how their covariances tell it.

    `sigma_m` and `sigma_deg` are of the residuals, `scene_m` and `scene_deg` of an error per log that no covariance
    knows. Covariances are reported as those of the residuals over a factor squared, for each log drawn between the two.

    `constant` is the share of the variance that all logs of a vehicle have in common, as biases of its LiDARs cause it,
    `place` that of logs in one place: each log has a place of its own, or those of a depot follow each other.
    """

    sigma_m: float = 0.003
    sigma_deg: float = 0.03
    factors: tuple[float, float] = (1.0, 1.0)
    scene_m: float = 0.0
    scene_deg: float = 0.0
    constant: float = 0.0
    place: float = 0.0
    depots: int = 0


@dataclass(frozen=True)
class Motion:
    """A change of a LiDAR, or of the target "top": at once from log `index` on, or growing from day `since`."""

    offset: Sequence[float]
    index: int | None = None
    since_days: float = 0.0


def random_times(rng, count):
    """Irregular times over a year."""
    return np.sort(START_NS + rng.integers(0, YEAR_NS, count))


def made_vehicle(
    rng, count, *, vehicle="v01", lidars=("left",), noise=Noise(), motions=None, times=None, mounted=MOUNTED
) -> list[LidarSeries]:
    """A series per LiDAR; each motion is rotation (rad), translation (m); of a creep, per 30 days."""
    times = random_times(rng, count) if times is None else times
    motions = motions or {}
    made = []
    for lidar in lidars:
        poses, covariances = [], []
        systematic = _systematic_errors(rng, noise, len(times)) if noise.constant + noise.place else None
        for index, time_ns in enumerate(times):
            pose = mounted[lidar].matrix
            if "top" in motions:
                pose = np.linalg.inv(_matrix(_share(motions["top"], index, time_ns))) @ pose
            if lidar in motions:
                pose = _shifted(pose, _share(motions[lidar], index, time_ns))
            covariance = _covariance(rng, noise) if systematic is None else systematic[0]
            scene = rng.normal(size=6) * np.array([np.deg2rad(noise.scene_deg)] * 3 + [noise.scene_m] * 3)
            random = (1.0 - noise.constant - noise.place) * covariance
            pose = _shifted(pose, rng.multivariate_normal(np.zeros(6), random, method="cholesky") + scene)
            if systematic is not None:
                pose = _shifted(pose, systematic[1][index])
            poses.append(RigidTransform.from_rotation_translation("top", lidar, pose[:3, :3], pose[:3, 3]))
            covariances.append(covariance / rng.uniform(*noise.factors) ** 2)
        keys = tuple(f"{vehicle}-{index:03d}" for index in range(len(times)))
        made.append(
            LidarSeries(vehicle, lidar, "top", keys, times, tuple(poses), np.array(covariances).reshape(-1, 6, 6))
        )
    return made


def made_fleet(rng, vehicles, count, *, assembly=(0.0, 0.0), mounted=MOUNTED, **options) -> list[LidarSeries]:
    """Vehicles with names in order and without changes, each mounted within the assembly's sigmas (m, deg)."""
    made = []
    for index in range(vehicles):
        own = {
            name: _moved(pose, rng.normal(size=6) * np.array([np.deg2rad(assembly[1])] * 3 + [assembly[0]] * 3))
            for name, pose in mounted.items()
        }
        made += made_vehicle(rng, count, vehicle=f"f{index:03d}", mounted=own, **options)
    return made


def with_wrong_logs(rng, series, share):
    """The series with that share of its poses wrong by some 100 mm."""
    poses = [
        _moved(pose, np.r_[np.zeros(3), 0.1 * rng.normal(size=3)]) if rng.random() < share else pose
        for pose in series.T_target_lidar
    ]
    return replace(series, T_target_lidar=tuple(poses))


def moved_mounting(lidar, offset):
    """The poses of the rig with one LiDAR elsewhere."""
    return {**MOUNTED, lidar: _moved(MOUNTED[lidar], offset)}


def _moved(pose, offset):
    matrix = _shifted(pose.matrix, offset)
    return RigidTransform.from_rotation_translation(pose.target, pose.source, matrix[:3, :3], matrix[:3, 3])


def _share(motion, index, time_ns):
    if motion.index is not None:
        return np.asarray(motion.offset, dtype=float) * (index >= motion.index)
    days = max(0.0, (time_ns - START_NS) / DAY_NS - motion.since_days)
    return np.asarray(motion.offset, dtype=float) * days / 30.0


def _matrix(offset):
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(offset[:3]).as_matrix()
    matrix[:3, 3] = offset[3:]
    return matrix


def _shifted(pose, offset):
    """A pose turned about its own origin and shifted, along the target's axes."""
    moved = pose.copy()
    moved[:3, :3] = Rotation.from_rotvec(offset[:3]).as_matrix() @ pose[:3, :3]
    moved[:3, 3] += offset[3:]
    return moved


def _systematic_errors(rng, noise, count):
    """The covariance of all logs of a vehicle, and the errors (count, 6) that it explains beside the random ones."""
    covariance = _covariance(rng, noise)
    places = np.arange(count) * noise.depots // count if noise.depots else np.arange(count)
    own = rng.multivariate_normal(np.zeros(6), noise.place * covariance, count, method="cholesky")[places]
    return covariance, own + rng.multivariate_normal(np.zeros(6), noise.constant * covariance, method="cholesky")


def _covariance(rng, noise):
    """Correlated, of another shape for each log, with the sigmas of the noise on average."""
    mix = Rotation.random(2, random_state=rng).as_matrix()
    axes = np.zeros((6, 6))
    axes[:3, :3], axes[3:, 3:] = mix
    coupling = np.eye(6) + 0.3 * rng.uniform(-1.0, 1.0, (6, 6))
    units = coupling @ axes * rng.uniform(0.5, 1.3, 6)
    units /= np.sqrt(np.mean(np.diag(units @ units.T)))
    scaled = np.array([np.deg2rad(noise.sigma_deg)] * 3 + [noise.sigma_m] * 3)[:, None] * units
    return scaled @ scaled.T
