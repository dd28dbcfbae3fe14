# SPDX-License-Identifier: Apache-2.0
"""The result document of a saved run, from whatever is left of it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from multilica.errors import SourceNotFoundError, UnreadableSourceError
from multilica.sinks.result_document import RESULT_SCHEMA
from multilica.sinks.result_files import RESULT_JSON

__all__ = ["RunDocument", "read_result_json", "read_run_document", "require_whole"]

_RECORDINGS = ("recording.rrd", "recording.partial.rrd")
_MCAPS = ("result.mcap", "result.partial.mcap")


@dataclass(frozen=True, slots=True, eq=False)
class RunDocument:
    """A run as it was saved.

    Args:
        path: the run as it was given.
        document: see `multilica.sinks.run_document`.
        recording: its `.rrd`; None if there is none.
    """

    path: Path
    document: Mapping[str, Any]
    recording: Path | None


def read_run_document(path: Path) -> RunDocument:
    """Read a run directory, its `result.json`, a recording, also one that was cut off, or its `result.mcap`.

    Raises:
        SourceNotFoundError: nothing there, or a directory without a run.
        UnreadableSourceError: damaged, or not of a run.
    """
    if not path.exists():
        raise SourceNotFoundError(
            f"No run at {path}; give a run directory, its {RESULT_JSON}, a recording (.rrd) or a result.mcap."
        )
    if path.suffix == ".rrd":
        return RunDocument(path, _recorded(path), path)
    if path.suffix == ".mcap":
        return RunDocument(path, _recorded(path), None)
    directory = path if path.is_dir() else path.parent
    recording, mcap = _first_in(directory, _RECORDINGS), _first_in(directory, _MCAPS)
    file = path / RESULT_JSON if path.is_dir() else path
    if file.exists():
        return RunDocument(path, read_result_json(file), recording)
    left = [one for one in (recording, mcap) if one is not None]
    if not left:
        raise SourceNotFoundError(_no_run(path, directory))
    return RunDocument(path, _of_what_is_left(left), recording)


def _no_run(path: Path, directory: Path) -> str:
    """Runs below it are those of the snapshots of a joint run that was killed before it came to a joint result."""
    names = (*_RECORDINGS, *_MCAPS)
    below = sorted(one.name for one in directory.iterdir() if one.is_dir() and _first_in(one, names))
    hint = f"; below it are the runs {', '.join(below)}" if below else ""
    return (
        f"{path} is not the directory of a run: it has neither {RESULT_JSON} nor {' nor '.join(names)}, "
        f"which `multilica calibrate --out` leaves{hint}."
    )


def _first_in(directory: Path, names: tuple[str, ...]) -> Path | None:
    return next((directory / name for name in names if (directory / name).exists()), None)


def _of_what_is_left(files: list[Path]) -> dict[str, Any]:
    """The document of the first that can be read: a run may have been killed while it began the other."""
    first, *others = files
    try:
        return _recorded(first)
    except UnreadableSourceError:
        if not others:
            raise
        return _of_what_is_left(others)


def _recorded(file: Path) -> dict[str, Any]:
    if file.suffix == ".mcap":
        from multilica.sinks.mcap_reading import read_attached_document

        return _of_schema(file, read_attached_document(file))
    from multilica.sinks.rerun_reading import read_recorded_document

    return _of_schema(file, read_recorded_document(file))


def read_result_json(file: Path) -> dict[str, Any]:
    """Read a `result.json`.

    Raises:
        UnreadableSourceError: not JSON, or of another schema.
    """
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise UnreadableSourceError(f"{file} is not a JSON file that can be read: {error}.") from error
    return _of_schema(file, document)


@contextmanager
def require_whole(source: object) -> Iterator[None]:
    """Refuse a document that lacks what is read of it within the block.

    Raises:
        UnreadableSourceError: it names the source.
    """
    try:
        yield
    except KeyError as error:
        raise UnreadableSourceError(f"{source} is not a whole result: it has no {error}.") from error
    except (AttributeError, TypeError, ValueError) as error:
        raise UnreadableSourceError(f"{source} is not a whole result: {error}.") from error


def _of_schema(file: Path, document: object) -> dict[str, Any]:
    schema = document.get("schema") if isinstance(document, Mapping) else None
    if schema != RESULT_SCHEMA or not isinstance(document, Mapping):
        raise UnreadableSourceError(
            f"{file} has schema {schema!r}; expected '{RESULT_SCHEMA}', as the {RESULT_JSON} of a run has it."
        )
    return dict(document)
