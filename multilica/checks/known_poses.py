# SPDX-License-Identifier: Apache-2.0
"""Tests of whether LiDARs are still at their known poses."""

from multilica.checks.comparison import RigCheck, check_rig
from multilica.checks.tolerances import RigTolerances
from multilica.config import CalibrationConfig
from multilica.extrinsics import Extrinsics
from multilica.results import CalibrationResult
from multilica.runs.run_documents import SavedRun
from multilica.snapshot import Snapshot
from multilica.verification import register_from_known


def verify_snapshot(
    snapshot: Snapshot,
    known: Extrinsics,
    tolerances: RigTolerances,
    config: CalibrationConfig | None = None,
    deadline_s: float | None = None,
) -> RigCheck:
    """Test which LiDARs are still at their known poses.

    Args:
        known: poses of two or more of the LiDARs, by name.
        config: the default preset if None.
        deadline_s: as for `register_from_known`.

    Raises:
        UnfitSnapshotError: fewer than two LiDARs have returns in range, or the vehicle moves.
        UsageError: the poses lack two of the LiDARs, or a tolerance is for none of them.
    """
    rig = register_from_known(snapshot, known, config, deadline_s=deadline_s)
    return check_found(rig, snapshot, known, tolerances)


def check_found(rig: CalibrationResult, snapshot: Snapshot, known: Extrinsics, tolerances: RigTolerances) -> RigCheck:
    """Compare the poses that `register_from_known` found in a snapshot with the known ones.

    Raises:
        UsageError: a tolerance is for none of the LiDARs.
    """
    found = check_rig(SavedRun(snapshot.source or "snapshot", rig.target, rig.placements), known, tolerances)
    far = {
        each.lidar for each in rig.placements if each.contradicts_prior
    }  # and no pose near the known one explains it
    why = "its beams contradict the known pose, and it is too far off to be tracked ({}); calibrate again"
    told = {
        each.lidar: each.model_copy(update={"verdict": "outside", "reason": why.format(each.reason)})
        for each in found.lidars
        if each.lidar in far
    }
    return found.model_copy(update={"lidars": tuple(told.get(each.lidar, each) for each in found.lidars)})


def decide_unplaced(
    check: RigCheck,
    snapshot: Snapshot,
    known: Extrinsics,
    tolerances: RigTolerances,
    config: CalibrationConfig | None = None,
    deadline_s: float | None = None,
) -> RigCheck:
    """Return the check of a calibration of the snapshot, with `verify_snapshot`'s word on LiDARs that it did not place.

    A search asks for more evidence than a test of known poses.

    Args:
        deadline_s: as for `register_from_known`.
    """
    unplaced = {each.lidar for each in check.lidars if each.verdict == "undecided" and each.distance_m is None}
    if not unplaced & known.members:
        return check
    near = verify_snapshot(snapshot, known, tolerances, config, deadline_s)
    decided = {each.lidar: each for each in near.lidars if each.verdict != "undecided"}
    if check.root in decided and decided[check.root].verdict == "outside":
        return check
    how = f"compared to {near.root}, registered from the reference, as the calibration did not place it"
    told = {
        name: decided[name].model_copy(update={"reason": f"{decided[name].reason}; {how}"})
        for name in unplaced & decided.keys()
    }
    return check.model_copy(update={"lidars": tuple(told.get(each.lidar, each) for each in check.lidars)})
