# SPDX-License-Identifier: Apache-2.0
"""A placement beside its prior, in words."""

from __future__ import annotations

import numpy as np

from multilica.geometry import FloatArray, rotation_vector_rad
from multilica.results import CalibrationResult, LidarPlacement

__all__ = ["surprise", "surprises"]

_MOUNT_PLAY_M = 0.3
_MOUNT_PLAY_RAD = float(np.deg2rad(10.0))
_HALF_TURN_RAD = float(np.deg2rad(150.0))
_MAINLY = 0.9
_MOUNTED = {"x": "upside down", "y": "upside down", "z": "backwards"}


def surprises(result: CalibrationResult) -> tuple[str, ...]:
    """A sentence on each LiDAR that stands farther from its prior than the play of a mount, with the likely cause."""
    found = (surprise(placement, result.target) for placement in result.placements)
    return tuple(text for text in found if text)


def surprise(placement: LidarPlacement, target: str) -> str | None:
    """The same for one LiDAR; None if it stands where its prior has it."""
    deviation, prior, found = placement.prior_deviation, placement.T_target_source_prior, placement.T_target_source
    if deviation is None or prior is None or found is None:
        return None
    off_m, off_rad = deviation
    if off_m <= _MOUNT_PLAY_M and off_rad <= _MOUNT_PLAY_RAD:
        return None
    axis = _main_axis(prior.rotation.T @ found.rotation)
    cause = f"{placement.lidar} or {target} is not where the prior has it"
    if axis and off_rad >= _HALF_TURN_RAD:
        cause = f"{placement.lidar} or {target} is mounted {_MOUNTED[axis]}, or the prior is wrong"
    turned = f"is turned by {np.rad2deg(off_rad):.0f} deg{f' about its {axis}' if axis else ''}"
    return f"{placement.lidar} {turned} against its prior and {off_m:.2f} m away from it: {cause}."


def _main_axis(rotation: FloatArray) -> str:
    """The axis that the rotation is mainly about; "" if there is none."""
    vector = rotation_vector_rad(rotation)
    along = int(np.argmax(np.abs(vector)))
    return "xyz"[along] if np.abs(vector[along]) >= _MAINLY * np.linalg.norm(vector) > 0.0 else ""
