# SPDX-License-Identifier: Apache-2.0
"""Poses that the user claims beforehand."""

from multilica.config import CalibrationConfig
from multilica.errors import UsageError
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.snapshot import Snapshot


def known_between(prior: Extrinsics | None, target: str, source: str) -> RigidTransform | None:
    """Return ``T_target_source`` by the prior; None if there is no prior or it lacks one of the LiDARs."""
    if prior is None or not {target, source} <= prior.members:
        return None
    return prior.between(target, source)


def require_usable(prior: Extrinsics, snapshot: Snapshot, config: CalibrationConfig) -> None:
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
