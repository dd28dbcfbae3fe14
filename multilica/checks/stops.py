# SPDX-License-Identifier: Apache-2.0
"""Checks of one vehicle at several stops, as one verdict."""

from collections.abc import Mapping, Sequence

from multilica.acceptance.placement import TOO_FEW_SURFACES
from multilica.checks.comparison import LidarCheck, RigCheck
from multilica.checks.known_poses import verify_snapshot
from multilica.checks.tolerances import RigTolerances
from multilica.config import CalibrationConfig
from multilica.errors import UnfitSnapshotError
from multilica.extrinsics import Extrinsics
from multilica.snapshot import Snapshot


def verify_stops(
    snapshots: Sequence[Snapshot],
    known: Extrinsics,
    tolerances: RigTolerances,
    config: CalibrationConfig | None = None,
    deadline_s: float | None = None,
) -> tuple[RigCheck, ...]:
    """Test at each stop of a vehicle which LiDARs are still at their known poses; arguments as `verify_snapshot`.

    Stops that cannot be used are left out with a note, if there are others. Notes of the reader are among the notes.

    Raises:
        UnfitSnapshotError: as `verify_snapshot`, for the first of the stops, none of which can be used.
        UsageError: as `verify_snapshot`.
    """
    checks: list[RigCheck] = []
    refusals: list[UnfitSnapshotError] = []
    for snapshot in snapshots:
        try:
            found = verify_snapshot(snapshot, known, tolerances, config, deadline_s)
            checks.append(found.model_copy(update={"notes": (*found.notes, *snapshot.notes)}))
        except UnfitSnapshotError as refusal:
            refusals.append(refusal)
    if not checks:
        raise refusals[0]
    notes = tuple(f"a stop is left out: {str(refusal).rstrip('.')}" for refusal in refusals)
    checks[0] = checks[0].model_copy(update={"notes": (*checks[0].notes, *notes)})
    return settle_stops(checks)


def without_common_view(checks: Sequence[RigCheck]) -> tuple[RigCheck, ...]:
    """Say of the LiDARs that see too little in common with others at every one of several stops what decides them."""
    seen = {
        each.lidar
        for check in checks
        for each in check.lidars
        if each.verdict != "undecided" or TOO_FEW_SURFACES not in each.reason
    }
    if len(checks) < 2:
        return tuple(checks)
    return tuple(
        check.model_copy(
            update={"lidars": tuple(each if each.lidar in seen else _blind(each) for each in check.lidars)}
        )
        for check in checks
    )


def _blind(each: LidarCheck) -> LidarCheck:
    told = "no stop has a common view, and `multilica check` on the log compares a new calibration"
    return each.model_copy(update={"reason": f"{each.reason}; {told}"})


def settle_stops(checks: Sequence[RigCheck]) -> tuple[RigCheck, ...]:
    """Let a LiDAR that one stop cannot decide be within where another stop finds it within.

    A LiDAR outside at any stop stays so there.
    """
    within: dict[str, tuple[RigCheck, LidarCheck | None]] = {}
    for check in checks:
        for each in check.lidars:
            if each.verdict == "within":
                within.setdefault(each.lidar, (check, each))
                within.setdefault(check.root, (check, None))
    return tuple(
        check.model_copy(update={"lidars": tuple(_settled(each, within) for each in check.lidars)}) for check in checks
    )


def _settled(each: LidarCheck, within: Mapping[str, tuple[RigCheck, LidarCheck | None]]) -> LidarCheck:
    if each.verdict != "undecided" or each.lidar not in within:
        return each
    check, found = within[each.lidar]
    told = f"others are compared to it at {check.name}" if found is None else f"{found.reason} at {check.name}"
    return each.model_copy(update={"verdict": "within", "reason": f"{told}; here: {each.reason}"})
