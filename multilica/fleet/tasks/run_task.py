# SPDX-License-Identifier: Apache-2.0
"""One log: from its address to its rows and files in the store, in a process that answers over a connection.

The process ends when its stdin does, so never outlives the one that started it.
"""

from __future__ import annotations

import errno
import os
import resource
import signal
import sys
import threading
import time
from collections.abc import Collection, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tomli_w

from multilica.checks import RigTolerances, check_found, relative_covariance, settle_stops
from multilica.config import CalibrationConfig
from multilica.diagnosis import explain
from multilica.drive_calibration import wanted_stops
from multilica.errors import InputError, MultilicaError, SourceNotFoundError, StorageError, UnfitSnapshotError
from multilica.events import CalibrationStarted, Event
from multilica.exports import read_extrinsics
from multilica.extrinsics import Extrinsics, extrinsics_table
from multilica.fleet.store.records import LidarRow, LogRow, with_pose
from multilica.fleet.store.store import Store, open_store
from multilica.fleet.tasks.guard import LogTask, LogTaskFailure, failed_row
from multilica.geometry import FloatArray, RigidTransform
from multilica.ingest import Stop, read_log, read_snapshot, require_calibratable, stops_of_log
from multilica.ingest.drive_reader import too_few_stops
from multilica.ingest.locate import locate
from multilica.ingest.memory import MemoryLimitError
from multilica.ingest.metadata import LogIdentity, identify_log
from multilica.ingest.remote.remote_file import ConnectionLostError
from multilica.optional_libraries import leave_out_pandas
from multilica.pipeline import calibrate
from multilica.results import CalibrationResult
from multilica.results.document import ResultDocument
from multilica.run import run_calibration
from multilica.runs.pose_error import PoseError
from multilica.runs.run_documents import read_run_document
from multilica.scratch import scratch_folder
from multilica.sinks.run_directory import open_run
from multilica.snapshot import Snapshot
from multilica.verification import register_from_known

_REFERENCE = "reference.toml"
_COLUMNS = {"recording.rrd": "recording", "report.html": "report", "result.mcap": "mcap"}
_ALSO = ("result.json", "calibration.toml")
_REASONS = {
    SourceNotFoundError: "not_found",
    MemoryLimitError: "memory",
    InputError: "unreadable",
    MultilicaError: "unusable",
}
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EROFS}


def run_log_task(request: LogTask) -> LogRow:
    """Verify or calibrate a log, and write its files and rows into the store, ahead without the row of the log.

    A log that another driver has finished meanwhile is written again, with the same content.

    Raises:
        ConnectionLostError: the server of the log does not answer.
        StorageError: the store, or the disk for temporary files, is full or refuses.
    """
    start_s, start_cpu_s = time.monotonic(), _cpu_s()
    store = open_store(request.store, create=False)
    try:
        row, lidars = _outcome(request, store)
    except (ConnectionLostError, StorageError):
        raise
    except UnfitSnapshotError as refusal:
        row, lidars = failed_row(request, refusal.code, str(refusal), state="refused"), []
    except MultilicaError as failure:
        _require_space(failure)
        reason = next(name for kind, name in _REASONS.items() if isinstance(failure, kind))
        row, lidars = failed_row(request, reason, str(failure)), []
    memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    row = replace(
        row,
        elapsed_s=time.monotonic() - start_s,
        cpu_s=_cpu_s() - start_cpu_s,
        memory_mb=max(memory_mb, request.max_memory_mb) if row.reason == "memory" else memory_mb,
        finished_at=datetime.now(UTC),
    )
    if request.ahead:
        store.write_lidars(row, lidars)
    else:
        store.finish(row, lidars)
    return row


def _require_space(failure: BaseException) -> None:
    """Raise StorageError if a failure comes from a disk of this machine that is full or read-only."""
    cause: BaseException | None = failure
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in _FULL:
            told = f"A temporary file cannot be written ({cause.strerror}); free space, or choose another TMPDIR."
            raise StorageError(told) from failure
        cause = cause.__cause__ or cause.__context__


def _outcome(request: LogTask, store: Store) -> tuple[LogRow, Sequence[LidarRow]]:
    request, stops, snapshots = _read(request)
    row, snapshot = request.row(), snapshots[0]
    names = {name for each in snapshots for name in each.names}
    row = replace(row, source_sha256=snapshot.source_sha256, lidars=len(names))
    if not request.ahead:
        first = store.first_with(row.source_sha256, request.vehicle, request.config_sha256, request.source)
        if first != request.source:
            return row.as_duplicate(first), []
    if not stops:
        require_calibratable(snapshot)
    known = None
    if request.reference:
        with scratch_folder() as folder:
            path = folder / _REFERENCE
            path.write_bytes(store.read(request.reference))
            known = read_extrinsics(path)
    if known is not None and request.calibrate == "when-needed" and names <= known.members:
        rows = _verified_rows(request, snapshots, known)
        if rows:
            row = replace(row, state="verified", placed=len(rows))
            return row, [*rows, *_rows_without_topic(request, known.target, known, names)]
    row, rows = _calibrated(request, store, row, known, snapshots, stops)
    return row, [*rows, *_rows_without_topic(request, rows[0].target, known, names)]


def _read(request: LogTask) -> tuple[LogTask, tuple[Stop, ...], tuple[Snapshot, ...]]:
    """Read the stops of a log, or else one snapshot; with the request whose configuration says so."""
    config = request.config
    wanted = wanted_stops(config)
    # Several stops come before the longest standstill.
    of_stops = config.ingest.model_copy(update={"window": "start"})
    stops = stops_of_log([locate(request.address)], wanted, config=of_stops)
    if len(stops) > 1:
        found = config.model_copy(update={"ingest": of_stops})
        return replace(request, config=found), stops, read_log(stops, wanted, config=of_stops)
    snapshot, told = read_snapshot(request.address, config=config.ingest), too_few_stops(stops, wanted)
    return request, (), (replace(snapshot, notes=(*snapshot.notes, told)) if told else snapshot,)


def _calibrated(
    request: LogTask,
    store: Store,
    row: LogRow,
    known: Extrinsics | None,
    snapshots: Sequence[Snapshot],
    stops: Sequence[Stop],
) -> tuple[LogRow, list[LidarRow]]:
    config = request.config
    if known is not None and not config.target and any(known.target in each.names for each in snapshots):
        config = config.model_copy(update={"target": known.target})
    prior = known if request.calibrate == "when-needed" else None
    with scratch_folder() as folder:
        out = folder / "run"
        if stops:
            run_calibration(request.address, out, _recorded(config, "slim"), prior=prior, stops=stops)
        else:
            _calibrate_into(out, snapshots[0], config, prior)
        document = read_run_document(out).document
        row = _stored(request, store, replace(row, state="calibrated"), out, document, known)
    return row, _calibrated_rows(request, document)


def _calibrate_into(out: Path, snapshot: Snapshot, config: CalibrationConfig, prior: Extrinsics | None) -> None:
    """Calibrate a snapshot, and write a run with a slim recording if all LiDARs are placed, else with one in full.

    A recording in full says why LiDARs are not placed. The events wait for the outcome, so that none is needed twice.
    """
    heard: list[Event] = []
    result = calibrate(snapshot, _recorded(config, "slim"), heard.append, prior)
    config = _recorded(config, "slim" if result.status == "complete" else "full")
    with open_run(out, config) as run:
        for event in heard:
            run(replace(event, config=config) if isinstance(event, CalibrationStarted) else event)


def _recorded(config: CalibrationConfig, detail: Literal["slim", "full"]) -> CalibrationConfig:
    return config.model_copy(update={"record": config.record.model_copy(update={"detail": detail})})


def _stored(
    request: LogTask, store: Store, row: LogRow, out: Path, document: ResultDocument, known: Extrinsics | None
) -> LogRow:
    """Copy the files of a run into the store, with the poses that hold from now on."""
    place, target = store.run_folder(request.vehicle, request.time_ns, request.key), document.target
    poses = {name: pose for name, pose in document.poses.items() if name in document.placed}
    if len(poses) > 1:
        kept = {}  # the last poses of LiDARs that were not placed now
        if known is not None and target in known.members:
            kept = {name: known.between(target, name) for name in known.members if name != target}
        reference = Extrinsics(target, {**kept, **Extrinsics(target, poses).T_target_source})
        if known is None or not _agree(reference, known, request.tolerances):
            store.write(f"{place}/{_REFERENCE}", tomli_w.dumps(extrinsics_table(reference)).encode())
            row = replace(row, calibration=f"{place}/{_REFERENCE}")
    names = [name for name in (*_COLUMNS, *_ALSO) if (out / name).exists()]
    size = sum(store.put(out / name, f"{place}/{name}") for name in names)
    written: dict[str, Any] = {column: f"{place}/{name}" for name, column in _COLUMNS.items() if name in names}
    return replace(row, placed=len(poses), artifacts_mb=size / 1e6, **written)


def _agree(found: Extrinsics, known: Extrinsics, tolerances: RigTolerances) -> bool:
    """Return whether poses are those that hold already, within the tolerances, so that these go on to hold."""
    if not found.members <= known.members:
        return False
    errors = {
        name: PoseError.between(pose, known.between(found.target, name)) for name, pose in found.T_target_source.items()
    }
    return all(tolerances.of(name).holds(error) for name, error in errors.items())


def _cpu_s() -> float:
    own, below = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return own.ru_utime + own.ru_stime + below.ru_utime + below.ru_stime


def _verified_rows(request: LogTask, snapshots: Sequence[Snapshot], known: Extrinsics) -> list[LidarRow]:
    """Return the poses near the known ones, relative to their target; none unless all LiDARs are where they were.

    The stop with the smallest covariance tells the pose of a LiDAR.
    """
    try:
        found = [register_from_known(snapshot, known, request.config) for snapshot in snapshots]
    except UnfitSnapshotError:
        if len(snapshots) == 1:
            raise
        return []  # a calibration can do without one of several stops
    at_stops = zip(found, snapshots, strict=True)
    checks = settle_stops([check_found(rig, snapshot, known, request.tolerances) for rig, snapshot in at_stops])
    if any(check.verdict != "within" for check in checks):
        return []
    rows = []
    for name in dict.fromkeys(name for snapshot in snapshots for name in snapshot.names):
        poses = [_pose_near_known(rig, name, known.target) for rig in found if {name, known.target} <= rig.poses.keys()]
        if not poses:
            return []
        pose, covariance = min(poses, key=lambda each: 0.0 if each[1] is None else float(np.trace(each[1])))
        rows.append(_row(request, name, known.target, "verified", "placed", pose, covariance))
    return rows


def _pose_near_known(found: CalibrationResult, name: str, target: str) -> tuple[RigidTransform, FloatArray | None]:
    covariance = None if name == target else relative_covariance(found[target], found[name], found.target)
    return found.poses[target].inverse() @ found.poses[name], covariance


def _calibrated_rows(request: LogTask, document: ResultDocument) -> list[LidarRow]:
    """Return the poses of a calibration, and why LiDARs have none or an uncertain one."""
    causes = {each.lidar: each for each in explain(document).unclear}
    evidence: dict[str, float] = {}
    for pair in document.pairs:
        for name in (pair.target, pair.source) if pair.verdict.accepted else ():
            evidence[name] = max(evidence.get(name, 0.0), pair.evidence)
    rows = []
    for name, entry in document.lidars.items():
        cause = causes.get(name)
        told = {"reason": cause.cause, "reason_text": cause.headline} if cause else {}
        covariance = None if entry.covariance is None or name == document.target else np.asarray(entry.covariance)
        pose, best = document.poses.get(name), evidence.get(name)
        rows.append(
            _row(request, name, document.target, "calibrated", entry.status, pose, covariance, evidence=best, **told)
        )
    return rows


def _rows_without_topic(
    request: LogTask, target: str, known: Extrinsics | None, names: Collection[str]
) -> list[LidarRow]:
    """Return a row for each LiDAR that the vehicle had before and that is not in the log."""
    told = {"reason": "no_topic", "reason_text": "The log has no scan of it."}
    missing = sorted(known.members - {*names}) if known else []
    return [_row(request, name, target, "verified", "not_placed", None, None, **told) for name in missing]


def _row(
    request: LogTask,
    lidar: str,
    target: str,
    how: Literal["verified", "calibrated"],
    status: Literal["placed", "uncertain", "not_placed"],
    pose: RigidTransform | None,
    covariance: FloatArray | None,
    **more: Any,  # noqa: ANN401 - fields of the row
) -> LidarRow:
    row = LidarRow(request.key, request.time_ns, request.source, lidar, target, how, status, **more)
    return row if pose is None else with_pose(row, pose, covariance)


def main() -> None:
    """Answer requests until stdin ends: a LogTask with its row, the address of a log with its LogIdentity."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the driver ends it
    threading.Thread(target=_end_with_stdin, daemon=True).start()
    leave_out_pandas()
    _limit_memory(float(sys.argv[2]))
    with Connection(int(sys.argv[1])) as requests:
        while True:
            requests.send(_answer(requests.recv()))


def _answer(request: LogTask | str) -> LogRow | LogIdentity | LogTaskFailure:
    try:
        return _treated(request)
    except ConnectionLostError as failure:
        return LogTaskFailure("network", str(failure), passes=True)
    except StorageError as failure:
        return LogTaskFailure("storage", str(failure), passes=failure.passes)
    except MemoryError:
        return LogTaskFailure("memory", "The log takes more memory than a task may have.")
    except Exception as failure:  # noqa: BLE001 - one log must not end the others
        text = f"This is a bug in multilica, not in the log ({type(failure).__name__}: {failure})."
        return LogTaskFailure("bug", text[:500])


def _treated(request: LogTask | str) -> LogRow | LogIdentity:
    try:
        return identify_log(request) if isinstance(request, str) else run_log_task(_below_folder(request))
    except OSError as failure:
        _require_space(failure)
        raise


def _below_folder(request: LogTask) -> LogTask:
    """Read a local log by its path below what was given, so that files and tables hold no path of the machine."""
    folder, below = request.address.removesuffix(request.source), request.source
    if folder in {"", request.address}:
        return request
    while below.startswith("~"):  # it would be read as the home of a user
        name, _, below = below.partition("/")
        folder += f"{name}/"
    if below and Path(folder).is_dir():
        os.chdir(folder)
        return replace(request, address=below)
    return request


def _end_with_stdin() -> None:
    sys.stdin.read()
    os._exit(0)


def _limit_memory(limit_mb: float) -> None:
    """Allow so much on top of what the libraries take."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    most = pages * resource.getpagesize() + round(limit_mb * 1e6)
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


if __name__ == "__main__":
    main()
