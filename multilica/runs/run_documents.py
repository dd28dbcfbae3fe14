# SPDX-License-Identifier: Apache-2.0
"""Readers of saved runs."""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from multilica.documents import MAX_JSON_BYTES, DocumentError, read_limited
from multilica.errors import SourceNotFoundError, UnreadableSourceError
from multilica.results import Knock, LidarPlacement, SnapshotReport
from multilica.results.document import ResultDocument, parse_result
from multilica.sinks.files.result_files import RESULT_JSON

_RECORDINGS = ("recording.rrd", "recording.partial.rrd")
_MCAPS = ("result.mcap", "result.partial.mcap")
_OF_OPENCALIB = b'"sensor_calib"'


@dataclass(frozen=True, slots=True, eq=False)
class RunDocument:
    """A saved run.

    Args:
        path: the run as it was given.
        recording: its `.rrd`; None if there is none.
    """

    path: Path
    document: ResultDocument
    recording: Path | None


@dataclass(frozen=True, slots=True, eq=False)
class SavedRun:
    """The outcome of one run, named by its directory, with a placement per LiDAR, the target among them."""

    name: str
    target: str
    placements: tuple[LidarPlacement, ...]
    knocks: tuple[Knock, ...] = ()
    snapshots: tuple[SnapshotReport, ...] = ()


def read_run_document(path: Path) -> RunDocument:
    """Read a run directory, its `result.json`, a recording, also a cut-off one, or its `result.mcap`.

    Raises:
        SourceNotFoundError: nothing there, or a directory without a run.
        UnreadableSourceError: damaged, or not of a run.
    """
    if not path.exists():
        raise SourceNotFoundError(
            f"No run at {path}; give a run directory, its {RESULT_JSON}, a recording (.rrd) or a result.mcap."
        )
    if path.suffix in (".rrd", ".mcap"):
        return RunDocument(path, _recorded([path]), path if path.suffix == ".rrd" else None)
    directory = path if path.is_dir() else path.parent
    recording, mcap = _first_in(directory, _RECORDINGS), _first_in(directory, _MCAPS)
    file = path / RESULT_JSON if path.is_dir() else path
    if file.exists():
        return RunDocument(path, _read_result_json(file), recording)
    left = [one for one in (recording, mcap) if one is not None]
    if not left:
        raise SourceNotFoundError(_no_run(path, directory))
    return RunDocument(path, _recorded(left), recording)


def _no_run(path: Path, directory: Path) -> str:
    """Describe a directory without a run; a joint run that was killed may have left runs of its snapshots below."""
    names = (*_RECORDINGS, *_MCAPS)
    below = sorted(one.name for one in directory.iterdir() if one.is_dir() and _first_in(one, names))
    hint = f"; below it are the runs {', '.join(below)}" if below else ""
    return (
        f"{path} is not the directory of a run: it has neither {RESULT_JSON} nor {' nor '.join(names)}, "
        f"which `multilica calibrate --out` leaves{hint}."
    )


def _first_in(directory: Path, names: tuple[str, ...]) -> Path | None:
    return next((directory / name for name in names if (directory / name).exists()), None)


def _recorded(files: list[Path]) -> ResultDocument:
    """Read the first readable file; a run may have been killed while it started to write the other."""
    first, *others = files
    try:
        if first.suffix == ".mcap":
            from multilica.sinks.mcap.messages import read_attached_document

            return read_attached_document(first)
        from multilica.sinks.rerun.reading import read_recorded_document

        return read_recorded_document(first)
    except UnreadableSourceError:
        if not others:
            raise
        return _recorded(others)


def _read_result_json(file: Path) -> ResultDocument:
    try:
        text = read_limited(file, MAX_JSON_BYTES)
    except (OSError, DocumentError) as error:
        raise UnreadableSourceError(f"{file} is not a JSON file that can be read: {error}.") from error
    return parse_result(file, text)


def read_run(path: Path) -> SavedRun:
    """Read a run directory or its `result.json`.

    Raises:
        SourceNotFoundError: nothing there, or a directory without a result.
        UnreadableSourceError: not JSON, of another schema, or damaged.
    """
    if not path.exists():
        raise SourceNotFoundError(f"No run at {path}; give a run directory or its {RESULT_JSON}.")
    file = path / RESULT_JSON if path.is_dir() else path
    if not file.exists():
        raise SourceNotFoundError(
            f"{path} is not the directory of a finished run: it has no {RESULT_JSON}, "
            "which `multilica calibrate --out` leaves when it ends."
        )
    return saved_run(RunDocument(file, _read_result_json(file), None), str(file.parent))


def saved_run(run: RunDocument, name: str) -> SavedRun:
    """Return the outcome of a run.

    Raises:
        UnreadableSourceError: it is damaged.
    """
    for each in run.document.placements:
        if each.covariance is not None and not np.all(np.linalg.eigvalsh(each.covariance) > 0.0):
            what = f"the covariance of LiDAR '{each.lidar}' is not a positive definite 6x6 matrix"
            raise UnreadableSourceError(f"{run.path} is not a whole result: {what}.")
    document = run.document
    return SavedRun(name, document.target, document.placements, document.knocks, document.snapshots)


def is_run(path: Path) -> bool:
    """Return whether `read_run_document` is meant to read it: a run directory or one of its files, not a recording.

    A JSON file is one of a run, whatever its name, unless it is OpenCalib's.
    """
    if path.is_dir():
        return (path / RESULT_JSON).exists() or any(_first_in(path, names) for names in (_RECORDINGS, _MCAPS))
    if path.suffix == ".json":
        with suppress(OSError, DocumentError):
            return _OF_OPENCALIB not in read_limited(path, MAX_JSON_BYTES)
    return path.suffix in (".json", ".rrd") or path.name in _MCAPS
