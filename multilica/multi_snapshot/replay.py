# SPDX-License-Identifier: Apache-2.0
"""Replay of a joint result as the events of a calibration."""

import hashlib
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from multilica import events
from multilica.config import STAGES, CalibrationConfig, Stage
from multilica.events import Observer
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.orchestration.rig import ground_under
from multilica.orchestration.stop_views import DriveStop
from multilica.results import (
    LEVEL_FRAME,
    CalibrationResult,
    DriveView,
    GroundPlane,
    PreprocessedCloud,
    Refinement,
    SnapshotReport,
)
from multilica.snapshot import LidarScans, Scan, Snapshot
from multilica.stages.ground import estimate_level
from multilica.stages.preprocess import preprocess


def shown_snapshot(result: CalibrationResult) -> str:
    """Return the name of the first snapshot that agrees with the joint result on the most LiDARs."""

    def agreeing(report: SnapshotReport) -> int:
        return sum(not deviation.outlier for deviation in report.deviations)

    return max((report for report in result.snapshots if not report.refusal), key=agreeing).name


def replay(
    snapshot: Snapshot,
    result: CalibrationResult,
    config: CalibrationConfig,
    observe: Observer,
    rig: Extrinsics | None = None,
    stops: Sequence[DriveStop] = (),
) -> CalibrationResult:
    """Emit the events of a joint result with the clouds of one of its snapshots.

    Args:
        snapshot: the one that `shown_snapshot` names.
        observe: called with the events of the joint stages and of the pairs of that snapshot.
        rig: as for `calibrate`.
        stops: with the clouds of those that links connect.

    Returns:
        The result with the ground plane of that snapshot, if the configuration asks for it.
    """
    clouds: list[PreprocessedCloud] = []
    ground: GroundPlane | None = None
    refusal = ""
    shown = _of_all(snapshot, result)
    observe(events.CalibrationStarted(shown, config, stops=tuple(stop.name for stop in result.stops)))
    with threadpool_limits(1):
        with _stage("preprocess", observe):
            for lidar in shown.lidars:
                clouds.append(preprocess(lidar, config.preprocess, config.stillness))
                observe(events.CloudPreprocessed(clouds[-1]))
        with _stage("fine", observe):
            for pair in result.pairs:
                observe(events.PairRegistered(pair))
        with _stage("refine", observe):
            observe(events.TargetChosen(result.target, result.target_reason))
            poses = tuple(pose for _, pose in sorted(result.poses.items()))
            observe(events.RigRefined(result.refinement or Refinement.of(), poses))
            if result.stops:
                observe(_linked(result, stops))
        if config.ground.enabled and config.until == STAGES[-1]:
            with _stage("ground", observe):
                points_m = {cloud.lidar: cloud.points_m for cloud in clouds}
                biases = () if result.refinement is None else result.refinement.biases
                ground, reason = ground_under(shown, result.target, points_m, result.poses, config, rig, biases)
                refusal = "" if ground else reason
                observe(events.GroundEstimated(ground, reason))
    level = (
        estimate_level(result.target, {cloud.lidar: cloud.points_m for cloud in clouds}, result.poses, config)
        if ground is None
        else RigidTransform(LEVEL_FRAME, result.target, ground.T_base_target.matrix)
    )
    result = replace(result, ground=ground, ground_refusal=refusal, level=level)
    observe(events.CalibrationFinished(result))
    return result


def _linked(result: CalibrationResult, stops: Sequence[DriveStop]) -> events.StopsLinked:
    linked = {stop.name for stop in result.stops}
    points_m = {
        DriveView(lidar, stop.name): prepared.cloud.points_m
        for stop in stops
        if stop.name in linked
        for lidar, prepared in stop.lidars.items()
    }
    return events.StopsLinked(result.stops, result.links, points_m)


@contextmanager
def _stage(stage: Stage, observe: Observer) -> Iterator[None]:
    observe(events.StageStarted(stage, 0))
    start_s = time.perf_counter()
    yield
    observe(events.StageFinished(stage, time.perf_counter() - start_s))


def _of_all(snapshot: Snapshot, result: CalibrationResult) -> Snapshot:
    """Return the snapshot with the sources of all, and empty LiDARs for those that only others have."""
    missing = tuple(
        LidarScans(place.lidar, (Scan(np.empty((0, 3), np.float32)),))
        for place in result.placements
        if place.lidar not in snapshot.names
    )
    note = f"one of {len(result.snapshots)} snapshots of the rig is shown: {shown_snapshot(result)}"
    return replace(
        snapshot,
        lidars=snapshot.lidars + missing,
        source=", ".join(report.source for report in result.snapshots),
        source_sha256=_sha256_of_all(result.snapshots),
        notes=(note, *snapshot.notes),
    )


def _sha256_of_all(reports: Sequence[SnapshotReport]) -> str:
    digests = [report.sha256 for report in reports]
    if len(set(digests)) == 1:  # stops of one log
        return digests[0]
    return hashlib.sha256("".join(sorted(digests)).encode()).hexdigest() if all(digests) else ""
