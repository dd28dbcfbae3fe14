# SPDX-License-Identifier: Apache-2.0
"""The adapter of each format."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack, closing
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import cast

from multilica.errors import UnreadableSourceError
from multilica.ingest.cloud_files import open_frames
from multilica.ingest.detect import PACKED, TITLES, detect_format
from multilica.ingest.downloaded import open_on_disk
from multilica.ingest.joined_recording import JoinedRecording
from multilica.ingest.ouster_recording import with_turns
from multilica.ingest.packed_file import open_packed
from multilica.ingest.recording import Recording
from multilica.ingest.remote_file import SourceFile
from multilica.ingest.source import Source, locate
from multilica.ingest.split_recording import SplitRecording

__all__ = ["open_source"]

_ADAPTERS = {
    "mcap": "multilica.ingest.mcap_file",
    "sqlite3": "multilica.ingest.ros2_sqlite",
    "ros1": "multilica.ingest.ros1_bag",
}
"""Format -> module whose `open_file` opens it; imported when such a file is opened."""
_READ_BY_RANGES = {"mcap"}
"""Formats that are read in place, wherever the file is."""


def open_source(source: Source) -> Recording:
    """Open the files of a source as one recording.

    Raises:
        UnreadableSourceError: not one of the files can be read.
    """
    if source.frames:
        return open_frames(source.frames)
    if source.recorders:
        return _open_recorders(source.recorders)
    files = source.recordings
    is_whole_file = len(files) == 1 and not source.missing
    return with_turns(_open_file(files[0]) if is_whole_file else _open_parts(files, source.missing))


def _open_file(file: SourceFile) -> Recording:
    name = detect_format(file)
    if name == PACKED:
        return open_on_disk(file, "a compressed file", partial(open_packed, open_file=_open_unpacked))
    adapter = import_module(_ADAPTERS[name])
    if name in _READ_BY_RANGES:
        return cast(Callable[[SourceFile], Recording], adapter.open_file)(file)
    return open_on_disk(file, TITLES[name], cast(Callable[[Path], Recording], adapter.open_file))


def _open_unpacked(path: Path) -> Recording:
    if detect_format(path) not in _ADAPTERS:
        raise UnreadableSourceError(f"{path.name} was compressed and is no recording; unpack it with `zstd -d`.")
    return _open_file(path)


def _open_recorders(sources: tuple[Source, ...]) -> Recording:
    with ExitStack() as opened:
        parts = []
        for source in sources:
            parts.append((locate(source.label), open_source(source)))
            opened.enter_context(closing(parts[-1][1]))
        joined = JoinedRecording(parts)
        opened.pop_all()
    return joined


def _open_parts(files: tuple[SourceFile, ...], missing: tuple[str, ...]) -> Recording:
    parts: list[Recording] = []
    errors: list[UnreadableSourceError] = []
    for file in files:
        try:
            parts.append(_open_file(file))
        except UnreadableSourceError as error:
            errors.append(error)
    if not parts:
        raise errors[0]
    damage = str(errors[0]).rstrip(".") if errors else ""
    if missing:
        damage = f"the bag lacks {missing[0]}, which its metadata.yaml names"
    return SplitRecording(parts, damage)
