# SPDX-License-Identifier: Apache-2.0
"""A calibration from recordings to a run directory."""

import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Literal

from multilica import events
from multilica.config import CalibrationConfig, Stage, require_ranges
from multilica.drive_calibration import calibrate_jointly, wanted_stops, ways_of
from multilica.errors import UnfitSnapshotError, UnknownNameError, UsageError
from multilica.events import Event, Observer, RunObserver
from multilica.extrinsics import Extrinsics
from multilica.ingest import (
    Stop,
    TakenSnapshot,
    find_snapshots,
    listen,
    live_address,
    read_log,
    read_prior,
    read_snapshot,
    require_calibratable,
    require_lidar,
    stops_of_log,
)
from multilica.ingest.locate import PathLike, locate, names_of, without_folders
from multilica.ingest.metadata import config_for
from multilica.ingest.recording import ProgressObserver
from multilica.ingest.remote.address import local_output, stem_of
from multilica.ingest.remote.remote_file import SourceFile
from multilica.multi_snapshot import SnapshotRun, replay, require_joinable, shown_snapshot
from multilica.orchestration import open_calibration_workers
from multilica.orchestration.clouds import require_libraries, without_blind_target
from multilica.orchestration.earlier_stops import EarlierStops
from multilica.orchestration.pairs import PreparedLidar
from multilica.orchestration.state import deadline_of
from multilica.pipeline import calibrate
from multilica.results import CalibrationResult
from multilica.sinks.aside import pass_aside
from multilica.sinks.run_directory import open_run
from multilica.snapshot import Snapshot
from multilica.stages.known_poses import require_free_base, require_usable_prior, require_usable_rig
from multilica.workers import Workers


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationRun:
    """A result with the files that hold it.

    Args:
        written: paths of its files, the extrinsics first, then the directories of the single snapshots.
        silent: topics of a running vehicle that sent nothing readable.
    """

    result: CalibrationResult
    config: CalibrationConfig
    directory: Path
    written: tuple[Path, ...]
    silent: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _Given:
    """One of the snapshots of a run.

    Args:
        name: of its directory in a joint run.
        source: of the recording, without folders.
        snapshot: None if it is read when its turn comes.
        address: of a running vehicle instead of files.
        lidars: names, as far as they were found before reading.
    """

    name: str
    source: str
    paths: tuple[SourceFile, ...]
    snapshot: Snapshot | None = None
    address: str = ""
    lidars: tuple[str, ...] = ()

    def read(self, config: CalibrationConfig) -> TakenSnapshot:
        if self.snapshot is not None:
            return TakenSnapshot(self.snapshot)
        if self.address:
            return listen(self.address, config=config.ingest)
        return TakenSnapshot(read_snapshot(self.paths, config=config.ingest))


@dataclass(frozen=True, slots=True, eq=False)
class _Request:
    """Settings that all snapshots of a run share."""

    config: CalibrationConfig
    prior: str | Extrinsics | None
    rig: Extrinsics | None
    mcap_encoding: str
    observe: RunObserver
    workers: Workers
    deadline_s: float


def run_calibration(
    sources: PathLike | Sequence[PathLike],
    out: str | Path | None = None,
    config: CalibrationConfig | None = None,
    *,
    prior: str | Extrinsics | None = None,
    rig: Extrinsics | None = None,
    stops: Sequence[Stop] | None = None,
    mcap_encoding: str = "foxglove",
    observe: RunObserver = events.ignore,
    workers: Workers | None = None,
) -> CalibrationRun:
    """Read recordings or listen to a running vehicle, calibrate, and write a run directory.

    Several recordings with the same LiDARs are several snapshots of one rig: each is calibrated into a directory of its
    own below `out`, then all of them jointly into `out`, with links between those that saw the same. So are the stops
    of one log, as many as `drive.stops` asks for. Every file is written under a temporary name and renamed when it is
    complete. An exception that ends the run carries a note on the files that are left in the directory.

    Args:
        sources: as for `take_snapshot`.
        out: the run directory, whose files are replaced; None: a new one from `default_directory`.
        config: None: the default preset, with all frames of what `multilica record` took.
        prior: poses to test in addition, as for `read_prior`.
        rig: as for `calibrate`.
        stops: of the log, as `stops_of_log` found them; None: those that `drive.stops` asks for.
        mcap_encoding: of `result.mcap`: ``foxglove`` or ``ros2``.
        observe: called with each event as it happens; not with those of the joint result.
        workers: an open pool, as for `calibrate`.

    Returns:
        The result, joint if there are several snapshots, with the paths of its files.

    Raises:
        InputError: the sources or the prior cannot be read, or no snapshot can be calibrated.
        UsageError: the configuration names something that does not exist or cannot be used with these sources, or
            `out` cannot be written to.
        WorkerDiedError: a worker process was killed or crashed.
    """
    place = None if out is None else local_output(out, "out")
    given = [sources] if isinstance(sources, PathLike) else sources
    address = live_address(given)
    files = [] if address else [locate(source) for source in given]
    config = config or CalibrationConfig(ingest=config_for(files))
    require_libraries(config)
    require_ranges(config)
    deadline_s = deadline_of(config)
    if address and config.drive.stops not in (1, "auto"):
        raise UsageError(f"Found drive.stops={config.drive.stops} and a running vehicle; only a log has stops.")
    found = [_Given("", "", (), address=address)] if address else _find(files, config, observe, stops)
    with nullcontext(workers) if workers else open_calibration_workers(config) as pool:
        request = _Request(config, prior, rig, mcap_encoding, observe, pool, deadline_s)
        if len(found) > 1:
            more = len(found) if len({each.paths for each in found}) > 1 else 1
            return _run_jointly(found, place or default_directory(files, more), request)
        taken = _read(found[0], config, observe)
        # Chosen after reading: of runs that start together, each finds what the others write.
        run = _run_one(taken.snapshot, place or default_directory([address] if address else files), request)
        return replace(run, silent=taken.silent)


def _find(
    files: Sequence[PathLike], config: CalibrationConfig, observe: RunObserver, stops: Sequence[Stop] | None
) -> list[_Given]:
    """Find the snapshots of recordings, or read the stops of a log, if it is to give several."""
    found = find_snapshots(files, config=config.ingest)
    if len(found) > 1:
        if config.target:
            require_lidar(config.target, found)
        names = names_of([source.paths[0] for source in found])
        return [
            _Given(source.name, name, source.paths, lidars=source.lidars)
            for source, name in zip(found, names, strict=True)
        ]
    (only,) = found
    wanted = wanted_stops(config)

    def told(doing: Literal["find stops", "read stops"]) -> ProgressObserver:
        return lambda done, total: observe(events.StopsProgressed(doing, done, total))

    if stops is None:
        stops = stops_of_log(only.paths, wanted, config=config.ingest, observe=told("find stops"))
    if not stops:
        return [_Given(only.name, only.name, only.paths)]
    snapshots = read_log(stops, wanted, config=config.ingest, observe=told("read stops"))
    lidars = {name for snapshot in snapshots for name in snapshot.names}
    if config.target and config.target not in lidars:
        raise UnknownNameError("LiDAR", config.target, lidars, only.name)
    if len(snapshots) == 1:
        return [_Given(only.name, only.name, only.paths, snapshots[0])]
    return [_Given(f"stop_{number}", each.source, only.paths, each) for number, each in enumerate(snapshots, start=1)]


def default_directory(sources: Sequence[PathLike], snapshots: int = 1) -> Path:
    """Return ``recordings/runs/<source>``, or the next of ``<source>-2``, ``<source>-3``, ... that holds nothing yet.

    Recordings of several vehicles often have one name, and only `out` says that an earlier run may go. A joint run
    never shares the directory with a run of its first snapshot alone.
    """
    more = f"-and-{snapshots - 1}-more" if snapshots > 1 else ""
    name = f"{stem_of(str(next(iter(sources), '')))}{more}"
    names = (name if number == 1 else f"{name}-{number}" for number in count(1))
    return next(path for each in names if not _holds_files(path := Path("recordings") / "runs" / each))


def _holds_files(path: Path) -> bool:
    return any(path.iterdir()) if path.is_dir() else path.exists()


def _read(given: _Given, config: CalibrationConfig, observe: RunObserver) -> TakenSnapshot:
    """Read a snapshot and check it; a source that is refused here leaves an earlier run directory as it was."""
    observe(events.StageStarted("ingest", 0))
    start_s = time.perf_counter()
    taken = given.read(config)
    snapshot = taken.snapshot
    require_calibratable(snapshot)
    if config.target:
        snapshot[config.target]
    require_free_base(snapshot, config)
    observe(events.StageFinished("ingest", time.perf_counter() - start_s))
    for note in snapshot.notes:
        observe(events.InputNoted(note))
    return taken


def _run_one(
    snapshot: Snapshot,
    directory: Path,
    request: _Request,
    prepared: dict[str, PreparedLidar] | None = None,
    earlier: EarlierStops | None = None,
) -> CalibrationRun:
    prior: Extrinsics | None = None
    if request.prior is not None:
        found = read_prior(request.prior, snapshot)
        require_usable_prior(found.extrinsics, snapshot, request.config)
        prior = found.extrinsics
        for note in found.notes:
            request.observe(events.InputNoted(note))
    if request.rig is not None:
        require_usable_rig(request.rig, snapshot, request.config)
    beside = pass_aside if request.workers.processes else nullcontext
    with (
        open_run(directory, request.config, request.mcap_encoding) as run,
        beside(_told_when_written(run, request.observe)) as observe,
    ):
        result = calibrate(
            snapshot,
            request.config,
            observe,
            prior,
            request.workers,
            request.rig,
            request.deadline_s,
            prepared,
            earlier,
        )
    return CalibrationRun(result, request.config, directory, run.written)


def _told_when_written(write: Observer, tell: RunObserver) -> Observer:
    """Report only stages that are in the files: stages that run together are written with the last one."""
    started: Stage = "ingest"
    waiting: list[Event] = []

    def pass_on(event: Event) -> None:
        nonlocal started
        write(event)
        if getattr(event, "stage", "") == "ingest":  # told when the snapshot was read
            return
        if isinstance(event, events.StageStarted):
            started = event.stage
        waiting.append(event)
        if not isinstance(event, events.StageFinished) or event.stage == started:
            while waiting:
                tell(waiting.pop(0))

    return pass_on


def _run_jointly(found: Sequence[_Given], directory: Path, request: _Request) -> CalibrationRun:
    config = request.config
    require_joinable(config)
    with open_run(directory, request.config, request.mcap_encoding) as run:
        run.start()
        alone = {given.name: partial(_run_alone, given, run.place / given.name, request) for given in found}
        ways = ways_of({given.name: given.snapshot for given in found if given.snapshot is not None})
        joint = calibrate_jointly(alone, config, request.workers, request.deadline_s, ways)
        shown = next(given for given in found if given.name == shown_snapshot(joint.result))
        result = replay(shown.read(config).snapshot, joint.result, config, run, request.rig, joint.stops)
    directories = tuple(path for given in found if (path := directory / given.name).is_dir())
    return CalibrationRun(result, config, directory, run.written + directories)


def _run_alone(
    given: _Given,
    directory: Path,
    request: _Request,
    prepared: dict[str, PreparedLidar] | None,
    earlier: EarlierStops,
) -> SnapshotRun:
    """Calibrate one of several snapshots; the others can do without one that is refused."""
    request.observe(events.SnapshotStarted(given.name))
    config, sha256 = request.config, ""
    try:
        snapshot = _read(given, config.model_copy(update={"target": ""}), request.observe).snapshot
        sha256 = snapshot.source_sha256
        own = without_blind_target(snapshot, config)
        if not own.target:
            # The joint result has the ground under the target.
            own = own.model_copy(update={"ground": config.ground.model_copy(update={"enabled": False})})
            request = replace(request, rig=None)
        result = _run_one(snapshot, directory, replace(request, config=own), prepared, earlier).result
    except UnfitSnapshotError as refusal:
        request.observe(events.SnapshotRefused(given.name, str(refusal)))
        (told,) = without_folders([str(refusal)], given.paths)
        lidars = given.lidars if given.snapshot is None else given.snapshot.names
        return SnapshotRun(given.name, None, given.source, sha256, refusal=told, lidars=lidars)
    return SnapshotRun(given.name, result, given.source, sha256)
