# SPDX-License-Identifier: Apache-2.0
"""Calibration of a rig from several stops of one drive."""

from collections.abc import Sequence
from functools import partial

from threadpoolctl import threadpool_limits

from multilica import events
from multilica.config import CalibrationConfig
from multilica.errors import UnfitSnapshotError
from multilica.events import Observer
from multilica.multi_snapshot.join import SnapshotRun, join, require_joinable
from multilica.orchestration import open_calibration_workers
from multilica.orchestration.links import MAX_LINKED_STOPS, search_links
from multilica.orchestration.pairs import PreparedLidar
from multilica.orchestration.state import deadline_of
from multilica.orchestration.stop_views import DriveStop, contradiction_at, levels_of
from multilica.pipeline import calibrate
from multilica.registration.motions import motion_pairs
from multilica.results import CalibrationResult
from multilica.snapshot import Snapshot
from multilica.workers import Workers


def calibrate_stops(
    snapshots: Sequence[Snapshot],
    config: CalibrationConfig | None = None,
    observe: Observer = events.ignore,
    workers: Workers | None = None,
    deadline_s: float | None = None,
) -> CalibrationResult:
    """Find the pose of every LiDAR from several stops of one vehicle.

    Each stop is calibrated alone. Then views of different stops are registered, so that a LiDAR may be placed by what
    another one saw of the same place at another stop. All stops count in one estimate at the end.

    Args:
        snapshots: with the same LiDARs; those of different places are joined without links.
        observe: called with the events of each stop.
    """
    config = config or CalibrationConfig()
    require_joinable(config)
    deadline_s = deadline_of(config) if deadline_s is None else deadline_s
    if workers is None:
        with open_calibration_workers(config) as opened:
            return calibrate_stops(snapshots, config, observe, opened, deadline_s)
    runs: list[SnapshotRun] = []
    stops: list[DriveStop] = []
    for number, snapshot in enumerate(snapshots):
        name = f"stop {number + 1}"
        prepared: dict[str, PreparedLidar] = {}
        own = config if config.target in snapshot.names else config.model_copy(update={"target": ""})
        try:
            result = calibrate(snapshot, own, observe, None, workers, None, deadline_s, prepared)
        except UnfitSnapshotError as refusal:
            runs.append(SnapshotRun(name, None, snapshot.source, refusal=str(refusal)))
            continue
        runs.append(SnapshotRun(name, result, snapshot.source, snapshot.source_sha256))
        stops.append(DriveStop(name, prepared, result.trusted))
    with threadpool_limits(1):
        names = {stop.name for stop in stops[:MAX_LINKED_STOPS]}
        on_way = motion_pairs([(run.name, each.motions) for run, each in zip(runs, snapshots, strict=True)], names)
        levels = levels_of(stops, config) if on_way else {}
        links = search_links(stops, config, workers, deadline_s, on_way)
        return join(runs, config, links, partial(contradiction_at, stops, config), on_way, levels)
