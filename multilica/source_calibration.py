# SPDX-License-Identifier: Apache-2.0
"""A calibration of what a recording or a snapshot holds, without files."""

from collections.abc import Sequence
from typing import Literal

from multilica import events, pipeline
from multilica.config import CalibrationConfig
from multilica.drive_calibration import calibrate_stops, wanted_stops
from multilica.errors import UsageError
from multilica.events import Observer
from multilica.extrinsics import Extrinsics
from multilica.ingest import read_drive, require_calibratable
from multilica.ingest.locate import PathLike
from multilica.orchestration.state import deadline_of
from multilica.results import CalibrationResult
from multilica.snapshot import Snapshot
from multilica.workers import Workers


def calibrate(
    source: Snapshot | Sequence[Snapshot] | PathLike | Sequence[PathLike],
    config: CalibrationConfig | None = None,
    observe: Observer = events.ignore,
    prior: Extrinsics | None = None,
    workers: Workers | None = None,
    rig: Extrinsics | None = None,
    stops: int | Literal["auto"] | None = None,
) -> CalibrationResult:
    """Find the pose of every LiDAR of a snapshot or a recording relative to the target LiDAR.

    `run_calibration` does the same and writes the files; it also takes recordings of several snapshots of one rig.

    Args:
        source: a snapshot with at least two LiDARs, several of one vehicle at different stops, or a source as for
            `read_snapshot`.
        config: the default preset if None.
        observe: called with each event of `multilica.events` as it happens.
        prior: known poses in metres and radians, by the LiDARs' names; tested like other hypotheses.
        rig: contains the target in the base frame `config.ground.frame`, for x, y and yaw of that frame.
        workers: an open pool, to start it once for several calibrations; None: a pool of its own.
        stops: standstills of a log to use, in place of `drive.stops`; with a prior or a rig, "auto" uses one.

    Returns:
        A pose `T_target_source` or a reason per LiDAR; a LiDAR that cannot be placed is a normal outcome.

    Raises:
        InputError: the source cannot be read, or is not fit to be calibrated.
        UsageError: the configuration, the prior or the rig names something that does not exist.
        MissingDependencyError: the source or the configuration needs a library that is not installed.
        WorkerDiedError: a worker process was killed or crashed.
    """
    ingest = None if config is None else config.ingest
    config = config or CalibrationConfig()
    if stops is not None:
        config = config.model_copy(update={"drive": config.drive.model_copy(update={"stops": stops})})
    deadline_s = deadline_of(config)
    snapshots = _as_snapshots(source)
    is_read = not snapshots
    if is_read:
        wanted = wanted_stops(config)
        alone = wanted == "auto" and (prior is not None or rig is not None)
        snapshots = [*read_drive(source, 1 if alone else wanted, config=ingest)]  # type: ignore[arg-type]
    if len(snapshots) > 1:
        if prior is not None or rig is not None:
            raise UsageError(f"A prior or a rig is for one snapshot, and {len(snapshots)} were given; leave it out.")
        return calibrate_stops(snapshots, config, observe, workers, deadline_s)
    (snapshot,) = snapshots
    if is_read:
        require_calibratable(snapshot)
    return pipeline.calibrate(snapshot, config, observe, prior, workers, rig, deadline_s)


def _as_snapshots(source: Snapshot | Sequence[Snapshot] | PathLike | Sequence[PathLike]) -> list[Snapshot]:
    """Return the snapshots of a source that is one or several; none if it has to be read.

    Raises:
        UsageError: snapshots and paths are mixed.
    """
    if isinstance(source, Snapshot):
        return [source]
    if isinstance(source, PathLike):
        return []
    snapshots = [each for each in source if isinstance(each, Snapshot)]
    if snapshots and len(snapshots) < len(source):
        raise UsageError("Expected snapshots or paths, found both; read the paths with `multilica.read_snapshot`.")
    return snapshots
