# SPDX-License-Identifier: Apache-2.0
"""Reader of the result document of a saved run."""

from dataclasses import dataclass
from pathlib import Path

from multilica.errors import SourceNotFoundError, UnreadableSourceError
from multilica.results.document import ResultDocument, parse_result
from multilica.sinks.files.result_files import RESULT_JSON

__all__ = ["RunDocument", "read_result_json", "read_run_document"]

_RECORDINGS = ("recording.rrd", "recording.partial.rrd")
_MCAPS = ("result.mcap", "result.partial.mcap")


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
        return RunDocument(path, read_result_json(file), recording)
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


def read_result_json(file: Path) -> ResultDocument:
    """Read a `result.json`.

    Raises:
        UnreadableSourceError: not JSON, of another schema, or damaged.
    """
    try:
        text = file.read_bytes()
    except OSError as error:
        raise UnreadableSourceError(f"{file} is not a JSON file that can be read: {error}.") from error
    return parse_result(file, text)
