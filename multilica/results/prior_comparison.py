# SPDX-License-Identifier: Apache-2.0
"""Sentences on the difference between a placement and its prior."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from multilica.geometry import FloatArray, RigidTransform, largest_index, rotation_angle_rad
from multilica.results import CalibrationResult, LidarPlacement

_MOUNT_PLAY_M = 0.3
_MOUNT_PLAY_RAD = float(np.deg2rad(10.0))
_HALF_TURN_RAD = float(np.deg2rad(150.0))
_MAINLY = 0.9
_NO_ANGLE, _NO_DISTANCE = "0 deg", "0.00 m"
_MOUNTED = {"x": "upside down", "y": "upside down", "z": "backwards"}


def surprises(result: CalibrationResult) -> tuple[str, ...]:
    """Describe every LiDAR whose pose differs from its prior by more than the play of a mount."""
    exchanged = exchanged_names(result.placements, result.target)
    found = (surprise(placement, result.target, exchanged) for placement in result.placements)
    return tuple(text for text in found if text)


def exchanged_names(placements: Sequence[LidarPlacement], target: str) -> tuple[str, str] | None:
    """Find two LiDARs with which all poses agree with the prior once their names are exchanged.

    The play of a mount is allowed. If the poses agree as they are named, nothing is exchanged.
    """
    poses = {
        placement.lidar: (placement.T_target_source_prior, placement.T_target_source)
        for placement in placements
        if placement.T_target_source_prior is not None and placement.T_target_source is not None
    }
    if target not in poses or all(_agree(*pose) for pose in poses.values()):
        return None
    for one, other in combinations(poses, 2):
        named = {name: name for name in poses} | {one: other, other: one}
        from_target = poses[named[target]][0].inverse()
        if all(_agree(from_target @ poses[named[name]][0], found) for name, (_, found) in poses.items()):
            return one, other
    return None


def _agree(prior: RigidTransform, found: RigidTransform) -> bool:
    off_m = float(np.linalg.norm(prior.xyz_m - found.xyz_m))
    return off_m <= _MOUNT_PLAY_M and rotation_angle_rad(prior.rotation.T @ found.rotation) <= _MOUNT_PLAY_RAD


def surprise(placement: LidarPlacement, target: str, exchanged: tuple[str, str] | None = None) -> str | None:
    """Describe how a placement differs from its prior, with the likely cause; None if it agrees with the prior.

    Args:
        exchanged: two LiDARs whose exchange explains the difference, as `exchanged_names` finds them.
    """
    deviation, prior, found = placement.prior_deviation, placement.T_target_source_prior, placement.T_target_source
    if deviation is None or prior is None or found is None:
        return None
    off_m, off_rad = deviation
    if off_m <= _MOUNT_PLAY_M and off_rad <= _MOUNT_PLAY_RAD:
        return None
    distance, angle = f"{off_m:.2f} m", f"{np.rad2deg(off_rad):.0f} deg"
    axis = _main_axis(prior.rotation.T @ found.rotation) if angle != _NO_ANGLE else ""
    cause = f"the pose of {placement.lidar} or {target} differs from the prior"
    if axis and off_rad >= _HALF_TURN_RAD:
        cause = f"{placement.lidar} or {target} is mounted {_MOUNTED[axis]}, or the prior is wrong"
    if exchanged is not None:
        cause = f"{exchanged[0]} and {exchanged[1]} have exchanged names, here or in the prior; everything else agrees"
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
    vector = Rotation.from_matrix(rotation).as_rotvec()
    along = largest_index(vector)
    return "xyz"[along] if np.abs(vector[along]) >= _MAINLY * np.linalg.norm(vector) else ""
