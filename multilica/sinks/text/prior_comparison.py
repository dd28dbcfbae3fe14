# SPDX-License-Identifier: Apache-2.0
"""Sentences on the difference between a placement and its prior."""

import numpy as np

from multilica.geometry import FloatArray, largest_index, rotation_vector_rad
from multilica.results import CalibrationResult, LidarPlacement

__all__ = ["surprise", "surprises"]

_MOUNT_PLAY_M = 0.3
_MOUNT_PLAY_RAD = float(np.deg2rad(10.0))
_HALF_TURN_RAD = float(np.deg2rad(150.0))
_MAINLY = 0.9
_NO_ANGLE, _NO_DISTANCE = "0 deg", "0.00 m"
_MOUNTED = {"x": "upside down", "y": "upside down", "z": "backwards"}


def surprises(result: CalibrationResult) -> tuple[str, ...]:
    """Describe every LiDAR whose pose differs from its prior by more than the play of a mount."""
    found = (surprise(placement, result.target) for placement in result.placements)
    return tuple(text for text in found if text)


def surprise(placement: LidarPlacement, target: str) -> str | None:
    """Describe how a placement differs from its prior, with the likely cause; None if it agrees with the prior."""
    deviation, prior, found = placement.prior_deviation, placement.T_target_source_prior, placement.T_target_source
    if deviation is None or prior is None or found is None:
        return None
    off_m, off_rad = deviation
    if off_m <= _MOUNT_PLAY_M and off_rad <= _MOUNT_PLAY_RAD:
        return None
    distance, angle = f"{off_m:.2f} m", f"{np.rad2deg(off_rad):.0f} deg"
    axis = _main_axis(prior.rotation.T @ found.rotation) if angle != _NO_ANGLE else ""
    cause = f"{placement.lidar} or {target} is not where the prior has it"
    if axis and off_rad >= _HALF_TURN_RAD:
        cause = f"{placement.lidar} or {target} is mounted {_MOUNTED[axis]}, or the prior is wrong"
    turned = f"turned by {angle}{f' about its {axis} axis' if axis else ''} against its prior"
    if angle == _NO_ANGLE:
        difference = f"{distance} away from its prior"
    elif distance == _NO_DISTANCE:
        difference = turned
    else:
        difference = f"{turned} and {distance} away from it"
    return f"{placement.lidar} is {difference}: {cause}."


def _main_axis(rotation: FloatArray) -> str:
    """Return the axis that the rotation is mainly about; "" if there is none."""
    vector = rotation_vector_rad(rotation)
    along = largest_index(vector)
    return "xyz"[along] if np.abs(vector[along]) >= _MAINLY * np.linalg.norm(vector) else ""
