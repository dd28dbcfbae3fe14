# SPDX-License-Identifier: Apache-2.0
"""Rigs on cars, few LiDARs of different kinds."""

import numpy as np

from multilica.simulate.rigs.bodies import car
from multilica.simulate.rigs.lidars import AERIES_II, AVIA, FALCON, NARROW, OS1_128, OS2_128, ROOF_64, SIDE_32, VLP_16
from multilica.simulate.rigs.rig import Mount, Rig


def fan(overlap_deg: float) -> Rig:
    """Build a rig of four narrow LiDARs on the roof; neighbours overlap by that angle."""
    step_deg = NARROW.pattern.horizontal_fov_deg - overlap_deg
    mounts = []
    for index, name in enumerate(("right", "front_right", "front_left", "left")):
        yaw_deg = step_deg * (index - 1.5)
        yaw_rad = np.deg2rad(yaw_deg)
        xyz_m = (0.3 * float(np.cos(yaw_rad)), 0.3 * float(np.sin(yaw_rad)), 1.95)
        mounts.append(Mount(name, NARROW, xyz_m, (0.0, 4.0 + 2.0 * (index % 2), yaw_deg)))
    return Rig("chain", tuple(mounts), car(1.7, 1.2, 1.1))


# Two 128-channel spinning LiDARs at the sides and two 120-degree solid-state LiDARs at the ends, all tilted.
EDGAR = Rig(
    "edgar",
    (
        Mount("front", FALCON, (1.45, 0.0, 2.12), (1.0, 6.0, 0.0)),
        Mount("left", OS1_128, (0.15, 0.72, 2.14), (2.0, 18.0, 88.0)),
        Mount("rear", FALCON, (-1.45, 0.0, 2.12), (-1.0, 8.0, 180.0)),
        Mount("right", OS1_128, (0.15, -0.72, 2.14), (-3.0, 17.0, -91.0)),
    ),
    car(1.95, 2.7, 1.5),
)
# 128-channel spinning, 16-channel spinning, rosette and frequency-modulated solid-state LiDARs, close together.
HELIPR = Rig(
    "helipr",
    (
        Mount("aeva", AERIES_II, (0.65, -0.22, 1.95), (0.5, 1.0, -1.0)),
        Mount("livox", AVIA, (0.75, 0.25, 2.10), (-0.5, 1.0, 1.5)),
        Mount("ouster", OS2_128, (0.0, 0.0, 2.20), (0.5, 0.5, 0.0)),
        Mount("velodyne", VLP_16, (-0.45, 0.05, 2.05), (0.0, -1.0, 2.0)),
    ),
    car(1.72, 1.7, 1.4),
)
# A 64-channel LiDAR on the roof and two 32-channel LiDARs at the sides, tilted by 45 degrees.
SIDES = Rig(
    "sides",
    (
        Mount("left", SIDE_32, (0.01, 0.57, 1.65), (-4.2, 45.1, 91.8)),
        Mount("right", SIDE_32, (-0.03, -0.56, 1.62), (-0.5, 45.8, -86.1)),
        Mount("top", ROOF_64, (0.0, 0.0, 2.05), (0.0, 0.0, 0.0)),
    ),
    car(1.52, 1.2, 1.0),
)
# Two narrow LiDARs that overlap, with a third that looks away from both.
BLIND = Rig(
    "blind",
    (
        Mount("front_left", NARROW, (1.0, 0.35, 1.9), (0.0, 5.0, 18.0)),
        Mount("front_right", NARROW, (1.0, -0.35, 1.9), (0.0, 6.0, -18.0)),
        Mount("rear", NARROW, (-1.0, 0.0, 1.9), (0.0, 6.0, 180.0)),
    ),
    car(1.7, 1.2, 1.1),
)
