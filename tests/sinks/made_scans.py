# SPDX-License-Identifier: Apache-2.0
"""A made-up street, and the snapshot of LiDARs in it."""

import numpy as np

from multilica.snapshot import LidarScans, Scan, Snapshot

STAMP_NS = 1_700_000_000_000_000_000


def made_street(random: np.random.Generator) -> np.ndarray:
    """A street: ground, two facades, a few poles."""
    ground = np.column_stack([random.uniform(-20, 20, (500, 2)), np.full(500, -2.0)])
    left = np.column_stack([random.uniform(-20, 20, 300), np.full(300, 8.0), random.uniform(-2, 4, 300)])
    right = np.column_stack([random.uniform(-20, 20, 300), np.full(300, -6.0), random.uniform(-2, 6, 300)])
    poles = np.column_stack([random.choice([-9.0, 3.0, 11.0], 100), np.full(100, 4.0), random.uniform(-2, 3, 100)])
    return np.concatenate([ground, left, right, poles])


def _scans(cloud: np.ndarray, stamp_ns: int) -> tuple[Scan, Scan]:
    return Scan(cloud[::2], stamp_ns), Scan(cloud[1::2], STAMP_NS + 10**8)


def made_snapshot(points: dict[str, np.ndarray]) -> Snapshot:
    lidars = tuple(
        LidarScans(name, _scans(cloud, STAMP_NS + 1000 * index), f"{name}_frame", f"/{name}")
        for index, (name, cloud) in enumerate(points.items())
    )
    return Snapshot(lidars, "drive.mcap", "c0ffee" * 10 + "abcd", notes=("12 of 20 scans, then the file ends",))
