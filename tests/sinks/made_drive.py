# SPDX-License-Identifier: Apache-2.0
"""Three stops of a made-up drive, and the registrations that link them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from multilica import events
from multilica.geometry import RigidTransform
from multilica.results import CalibrationResult, DriveView, StopLink, StopPose

FIRST = "stop_1"
PLACES = {FIRST: (0.0, 0.0, 0.0), "stop_2": (6.0, 1.0, 0.8), "stop_3": (8.0, 5.0, 2.0)}
STOPS = tuple(
    StopPose(
        name,
        FIRST,
        RigidTransform.from_xyz_rpy(FIRST, name, (x_m, y_m, 0.0), (0.0, 0.0, yaw_rad)),
        None if name == FIRST else 1e-6 * np.eye(6),
    )
    for name, (x_m, y_m, yaw_rad) in PLACES.items()
)
LINKS = (
    StopLink("top", FIRST, "top", "stop_2", 12.0, used=True, after_m=0.004, after_deg=0.02, probability=0.4),
    StopLink("front left/1", "stop_2", "top", "stop_3", 9.0, used=True, after_m=0.006, after_deg=0.03, probability=0.3),
    StopLink("rear", FIRST, "rear", "stop_3", 3.0, used=False, reason="no other registration confirms it"),
)


def linked(result: CalibrationResult) -> CalibrationResult:
    return replace(result, stops=STOPS, links=LINKS)


def stops_linked(points_m: dict[str, np.ndarray]) -> events.StopsLinked:
    """All LiDARs see the same at each stop, and fewer points at a later one."""
    seen = {
        DriveView(lidar, stop.name): points[: len(points) // number]
        for number, stop in enumerate(STOPS, start=1)
        for lidar, points in points_m.items()
    }
    return events.StopsLinked(STOPS, LINKS, seen)
