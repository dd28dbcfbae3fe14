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

# One of a hundred LiDARs that have not moved seems to have moved as far.
_UNLIKELY = 0.01


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
    """Let a LiDAR that one stop cannot decide be within where other stops find it within.

    They must compare it to the root of that stop, directly or by way of others: two groups of LiDARs that no stop
    compares may have moved apart. A LiDAR outside at any stop stays so there, and so does one that a stop measured
    outside its tolerance if chance hardly explains that: it may have moved since.
    """
    within: dict[str, tuple[RigCheck, LidarCheck | None]] = {}
    groups: list[set[str]] = []
    for check in checks:
        for each in check.lidars:
            if each.verdict == "within":
                within.setdefault(each.lidar, (check, each))
                within.setdefault(check.root, (check, None))
                groups = _joined({each.lidar, check.root}, groups)
    settled = []
    for check in checks:
        group = next((names for names in groups if check.root in names), set())
        known = {name: found for name, found in within.items() if name in group}
        settled.append(check.model_copy(update={"lidars": tuple(_settled(each, known) for each in check.lidars)}))
    return tuple(settled)


def _joined(names: set[str], groups: Sequence[set[str]]) -> list[set[str]]:
    """Return groups of LiDARs after some turn out to belong together."""
    apart = [group for group in groups if not group & names]
    return [*apart, names.union(*(group for group in groups if group & names))]


def _settled(each: LidarCheck, within: Mapping[str, tuple[RigCheck, LidarCheck | None]]) -> LidarCheck:
    if each.verdict != "undecided" or each.lidar not in within or _is_likely_outside(each):
        return each
    check, found = within[each.lidar]
    told = f"others are compared to it at {check.name}" if found is None else f"{found.reason} at {check.name}"
    return each.model_copy(update={"verdict": "within", "reason": f"{told}; here: {each.reason}"})


def _is_likely_outside(each: LidarCheck) -> bool:
    """Return whether a LiDAR is measured outside its tolerance, and chance hardly explains it."""
    measured = (
        (each.distance_m, each.max_translation_m, each.translation_probability),
        (each.angle_deg, each.max_rotation_deg, each.rotation_probability),
    )
    return any(
        off is not None and off > most and probability is not None and probability < _UNLIKELY
        for off, most, probability in measured
    )
