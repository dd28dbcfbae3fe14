# SPDX-License-Identifier: Apache-2.0
"""What the tables of the made-up run show, in metres and degrees by the heading of the column."""

from __future__ import annotations

import numpy as np

from tests.sinks.made_events import TRUTH
from tests.sinks.numbers import made_numbers as made
from tests.sinks.numbers.readers import rpy_deg_of

POSED = (made.FRONT, made.REAR)
LARGEST_BEFORE_MM, LARGEST_BEFORE_DEG, LARGEST_AFTER_MM, LARGEST_AFTER_DEG, _ = np.max(
    [*made.RESIDUALS.values()], axis=0
)


def pose_columns(lidar: str) -> dict[str, float]:
    matrix = TRUTH[lidar].matrix
    lengths = {f"{axis} m": value for axis, value in zip("xyz", matrix[:3, 3], strict=True)}
    angles = zip(("roll deg", "pitch deg", "yaw deg"), rpy_deg_of(matrix), strict=True)
    return {**lengths, **dict(angles)}


def placement_columns(lidar: str) -> dict[str, float]:
    """Of a LiDAR with a pose; sigma is that of the weakest direction."""
    return {
        **pose_columns(lidar),
        "sigma m": np.sqrt(np.linalg.eigvalsh(made.covariance_of(lidar)[3:, 3:])[-1]),
        "sigma deg": np.degrees(np.sqrt(np.linalg.eigvalsh(made.covariance_of(lidar)[:3, :3])[-1])),
        "fitness": made.POSE_FITNESS[lidar],
    }


def farthest(snapshot: str) -> tuple[str, float, float]:
    """The LiDAR that is off most, by how many mm, and deg."""
    lidar, (mm, deg) = max(made.DEVIATIONS[snapshot].items(), key=lambda item: item[1][0])
    return lidar, mm, deg
