# SPDX-License-Identifier: Apache-2.0
"""The real scans of `../shared/data/opencalib-0001`, with what is known of their truth."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from multilica.config import CalibrationConfig, with_overrides
from multilica.geometry import FloatArray, RigidTransform
from multilica.registration.lazy_open3d import o3d
from multilica.snapshot import LidarScans, Scan, Snapshot

DATA = Path(__file__).parents[2] / "shared" / "data" / "opencalib-0001"
MISSING = "the real scans are not beside this checkout (../shared/data)"
CONFIG = with_overrides(CalibrationConfig(), ["target=top"])
SOURCES = ("left", "right")

# From their README: four methods agree on xyz m, rpy deg within the tolerances.
TRUTH = {
    name: RigidTransform.from_xyz_rpy("top", name, xyz_m, np.deg2rad(rpy_deg))
    for name, xyz_m, rpy_deg in (
        ("left", [0.01, 0.57, -0.40], [-4.2, 45.1, 91.8]),
        ("right", [-0.03, -0.56, -0.43], [-0.5, 45.8, -86.1]),
    )
}
# Their spread, and the sigma of this one scene where it does not tell a range bias from a shift.
_TOLERANCE_M = 0.02 + 0.015
_TOLERANCE_DEG = np.array([0.3, 0.3, 0.4])


def read_clouds() -> dict[str, FloatArray]:
    """Per LiDAR its (N, 3) points in metres."""
    names = ("top", *SOURCES)
    return {name: np.asarray(o3d.io.read_point_cloud(str(DATA / f"{name}.pcd")).points) for name in names}


def turned_snapshot(clouds: Mapping[str, FloatArray], rotations: Mapping[str, FloatArray]) -> Snapshot:
    """The scans, those with a rotation (3, 3) turned by it about their own origin."""
    return Snapshot(
        tuple(
            LidarScans(name, (Scan(points_m @ rotations[name].T if name in rotations else points_m),))
            for name, points_m in clouds.items()
        )
    )


def unturned(placed: RigidTransform, rotation: FloatArray) -> RigidTransform:
    """A pose ``T_top_<name>`` of the scan as it was before it was turned by that rotation."""
    return RigidTransform.from_rotation_translation(
        placed.target, placed.source, placed.rotation @ rotation, placed.xyz_m
    )


def is_true(found: RigidTransform) -> bool:
    """Whether a pose ``T_top_<name>`` of the scan as it is lies where the four methods agree."""
    true = TRUTH[found.source]
    near = np.abs(found.xyz_m - true.xyz_m) <= _TOLERANCE_M
    return bool(near.all() and np.all(np.abs(found.rpy_deg - true.rpy_deg) <= _TOLERANCE_DEG))
