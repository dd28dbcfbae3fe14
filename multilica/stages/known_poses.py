# SPDX-License-Identifier: Apache-2.0
"""Poses that the user gives: a prior, or a rig in the vehicle's base frame."""

from multilica.config import CalibrationConfig
from multilica.errors import UnknownNameError, UsageError
from multilica.extrinsics import Extrinsics, require_metres
from multilica.geometry import RigidTransform
from multilica.snapshot import LidarScans, Snapshot


def known_between(prior: Extrinsics | None, target: str, source: str) -> RigidTransform | None:
    """Return ``T_target_source`` by the prior; None if there is no prior or it lacks one of the LiDARs."""
    if prior is None or not {target, source} <= prior.members:
        return None
    return prior.between(target, source)


def require_usable_prior(prior: Extrinsics, snapshot: Snapshot, config: CalibrationConfig) -> None:
    """Refuse a prior that cannot be checked or has too few LiDARs.

    Raises:
        UsageError: verification is off, or fewer than two of the snapshot's LiDARs are in the prior.
    """
    if not config.verify.enabled:
        raise UsageError(
            f"A prior is checked by stage verify, which is off (verify.enabled=false, preset '{config.preset}'); "
            "leave the prior out, or set verify.enabled=true."
        )
    known = sorted(prior.members & {*snapshot.names})
    if len(known) < 2:
        raise UsageError(
            f"The prior has {len(known)} LiDAR(s) of {snapshot.source or 'the snapshot'} "
            f"({', '.join(known) or 'none'}); it needs two or more of {', '.join(snapshot.names)}."
        )


def known_in_base(rig: Extrinsics, base: str, lidar: LidarScans) -> RigidTransform | None:
    """Return ``T_base_lidar`` by name, else by frame id; None if the rig lacks it."""
    frame = next((name for name in (lidar.name, lidar.frame_id.removeprefix("/")) if name in rig.members), None)
    return None if frame is None else RigidTransform(base, lidar.name, rig.between(base, frame).matrix)


def require_free_base(snapshot: Snapshot, config: CalibrationConfig) -> None:
    """Refuse a name of the base frame that a LiDAR has: the base would be a part of its own tree of frames.

    Raises:
        UsageError: a LiDAR has it.
    """
    base = config.ground.frame
    if config.ground.enabled and base in snapshot.names:
        raise UsageError(f"The base frame '{base}' has the name of a LiDAR; choose another name (--base).")


def require_usable_rig(rig: Extrinsics, snapshot: Snapshot, config: CalibrationConfig) -> None:
    """Refuse a rig without the base frame, or without a LiDAR that may become the target.

    Raises:
        UnknownNameError: it lacks the base frame.
        UsageError: it lacks a LiDAR.
        InputError: a joint between them moves, or the lengths are no metres.
    """
    base = config.ground.frame
    if base not in rig.members:
        raise UnknownNameError("frame", base, rig.members, "the rig file")
    candidates = [snapshot[config.target]] if config.target else snapshot.lidars
    for lidar in candidates:
        if (pose := known_in_base(rig, base, lidar)) is None:
            known = [each.name for each in snapshot.lidars if known_in_base(rig, base, each) is not None]
            hint = f"give --target, one of {', '.join(known)}" if known else "it has none of the LiDARs"
            raise UsageError(f"The rig file has no pose of '{lidar.name}', which may become the target; {hint}.")
        require_metres(pose, "The rig file")
