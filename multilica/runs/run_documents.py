# SPDX-License-Identifier: Apache-2.0
"""Readers of saved runs."""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from multilica.diagnosis import Explanation, explain
from multilica.documents import MAX_JSON_BYTES, DocumentError, read_limited
from multilica.errors import SourceNotFoundError, UnreadableSourceError
from multilica.geometry import FloatArray, RigidTransform, read_only
from multilica.results.document import LidarEntry, ResultDocument, parse_result
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
class SavedPlacement:
    """The placement of one LiDAR.

    Args:
        T_target_source: its pose in the run's target frame; None if it is neither placed nor uncertain.
        covariance: (6, 6) of the pose, order rotation (rad), translation (m), along the target's axes.

    Raises:
        ValueError: the covariance is not a positive definite 6x6 matrix.
    """

    lidar: str
    T_target_source: RigidTransform | None
    fitness: float | None
    reason: str
    covariance: FloatArray | None = None
    uncertain: bool = False

    def __post_init__(self) -> None:
        if self.covariance is not None and not np.all(np.linalg.eigvalsh(self.covariance) > 0.0):
            raise ValueError(f"the covariance of LiDAR '{self.lidar}' is not a positive definite 6x6 matrix")


@dataclass(frozen=True, slots=True, eq=False)
class SavedRun:
    """The outcome of one run, named by its directory, with a placement per LiDAR, the target among them."""

    name: str
    target: str
    placements: tuple[SavedPlacement, ...]


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
            from multilica.sinks.mcap.reading import read_attached_document

            return read_attached_document(first)
        from multilica.sinks.rerun.reading import read_recorded_document

        return read_recorded_document(first)
    except UnreadableSourceError:
        if not others:
            raise
        return _recorded(others)


def _read_result_json(file: Path) -> ResultDocument:
    """Read a `result.json`.

    Raises:
        UnreadableSourceError: not JSON, of another schema, or damaged.
    """
    try:
        text = read_limited(file, MAX_JSON_BYTES)
    except (OSError, DocumentError) as error:
        raise UnreadableSourceError(f"{file} is not a JSON file that can be read: {error}.") from error
    return parse_result(file, text)


def explain_run(path: Path) -> Explanation:
    """Explain a run directory, its `result.json`, a recording, also a cut-off one, or its `result.mcap`.

    Raises:
        SourceNotFoundError: nothing there, or a directory without a run.
        UnreadableSourceError: damaged, or not of a run.
    """
    return explain(read_run_document(path).document)


def read_run(path: Path) -> SavedRun:
    """Read a run directory or its `result.json`.

    Raises:
        SourceNotFoundError: nothing there, or a directory without a result.
        UnreadableSourceError: not JSON, of another schema, or damaged.
    """
    file = _result_file(path)
    return saved_run(RunDocument(file, _read_result_json(file), None), str(file.parent))


def saved_run(run: RunDocument, name: str) -> SavedRun:
    """Return the outcome of a run.

    Raises:
        UnreadableSourceError: it is damaged.
    """
    try:
        placements = tuple(
            _placement(run.document, lidar, entry) for lidar, entry in sorted(run.document.lidars.items())
        )
    except ValueError as error:
        raise UnreadableSourceError(f"{run.path} is not a whole result: {error}.") from error
    return SavedRun(name, run.document.target, placements)


def is_run(path: Path) -> bool:
    """Tell whether `read_run_document` is meant to read it: a run directory or one of its files, not a recording.

    A JSON file is one of a run, whatever its name, unless it is OpenCalib's.
    """
    if path.is_dir():
        return (path / RESULT_JSON).exists() or any(_first_in(path, names) for names in (_RECORDINGS, _MCAPS))
    if path.suffix == ".json":
        with suppress(OSError, DocumentError):
            return _OF_OPENCALIB not in read_limited(path, MAX_JSON_BYTES)
    return path.suffix in (".json", ".rrd") or path.name in _MCAPS


def _result_file(path: Path) -> Path:
    if not path.exists():
        raise SourceNotFoundError(f"No run at {path}; give a run directory or its {RESULT_JSON}.")
    if not path.is_dir():
        return path
    file = path / RESULT_JSON
    if not file.exists():
        raise SourceNotFoundError(
            f"{path} is not the directory of a finished run: it has no {RESULT_JSON}, "
            "which `multilica calibrate --out` leaves when it ends."
        )
    return file


def _placement(document: ResultDocument, lidar: str, entry: LidarEntry) -> SavedPlacement:
    covariance = None if entry.covariance is None else read_only(entry.covariance, np.float64)
    uncertain = entry.status == "uncertain"
    return SavedPlacement(lidar, document.pose(lidar), entry.fitness, entry.reason, covariance, uncertain)
