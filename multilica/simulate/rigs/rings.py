# SPDX-License-Identifier: Apache-2.0
"""Rigs of equal LiDARs around the roof."""

import numpy as np

from multilica.simulate.rigs.bodies import car, shuttle
from multilica.simulate.rigs.lidars import FALCON, OS1_64
from multilica.simulate.rigs.rig import Mount, Rig
from multilica.simulate.shapes.mesh import Mesh


def _sectors(name: str, count: int, roof_edge_m: tuple[float, float, float], body: Mesh) -> Rig:
    """Build a rig of LiDARs that look outwards, at even angles, from an ellipse with two half axes and a height."""
    half_x_m, half_y_m, height_m = roof_edge_m
    mounts = []
    for index in range(count):
        yaw_deg = 360.0 * index / count
        yaw_rad = np.deg2rad(yaw_deg)
        xyz_m = (half_x_m * float(np.cos(yaw_rad)), half_y_m * float(np.sin(yaw_rad)), height_m)
        mounts.append(Mount(f"at_{round(yaw_deg):03d}", FALCON, xyz_m, (0.0, 5.0 + index % 3, yaw_deg)))
    return Rig(name, tuple(mounts), body)


# Six 64-channel spinning LiDARs on a circle of 1.53 m, at different heights, most of them tilted: all see all around.
RING6 = Rig(
    "ring6",
    (
        Mount("front", OS1_64, (1.530, 0.0, 2.20), (0.0, 8.0, 0.0)),
        Mount("front_left", OS1_64, (0.765, 1.325, 2.15), (-12.0, 3.0, 60.0)),
        Mount("front_right", OS1_64, (0.765, -1.325, 2.15), (14.0, 0.0, -60.0)),
        Mount("rear", OS1_64, (-1.530, 0.0, 2.30), (0.0, -6.0, 180.0)),
        Mount("rear_left", OS1_64, (-0.765, 1.325, 2.25), (-2.0, 0.0, 120.0)),
        Mount("rear_right", OS1_64, (-0.765, -1.325, 2.10), (9.0, -4.0, -120.0)),
    ),
    shuttle(4.6, 2.4, 1.95),
)
SECTORS8 = _sectors("sectors8", 8, (1.6, 0.75, 2.12), car(1.95, 3.0, 1.4))
SECTORS20 = _sectors("sectors20", 20, (3.3, 0.95, 2.25), shuttle(7.0, 2.1, 2.1))
