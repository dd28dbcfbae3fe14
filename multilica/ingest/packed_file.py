# SPDX-License-Identifier: Apache-2.0
"""Recordings that are compressed as a whole."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Collection
from pathlib import Path

import zstandard

from multilica.ingest.damage import DamagedRecordingError
from multilica.ingest.recording import Messages, Recording, Span, Topic

__all__ = ["open_packed"]

_BLOCK_BYTES = 1 << 20
_MAX_RATIO = 200
_ALWAYS_BYTES = 64 << 20
"""Scans shrink to a half or a fifth; what grows to more than 200 times its size, and to more than this, is a trap."""


def open_packed(path: Path, open_file: Callable[[Path], Recording]) -> Recording:
    """Unpack a file that was compressed with zstd into a temporary folder, and open it there.

    Raises:
        DamagedRecordingError: it cannot be unpacked, or grows beyond all bounds.
    """
    folder = Path(tempfile.mkdtemp(prefix="multilica-"))
    try:
        unpacked = folder / path.stem
        _unpack(path, unpacked)
        return PackedRecording(open_file(unpacked), folder)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


class PackedRecording:
    """A recording in a temporary folder, which goes when it is closed."""

    def __init__(self, recording: Recording, folder: Path) -> None:
        self.format = f"{recording.format}, zstd"
        self.damage = recording.damage
        self.topics: tuple[Topic, ...] = recording.topics
        self.is_indexed = recording.is_indexed
        self._recording = recording
        self._folder = folder

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """As of the recording."""
        return self._recording.span_ns(topics)

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """As of the recording."""
        return self._recording.messages(topics, start_ns)

    def close(self) -> None:
        """Close and remove the unpacked file."""
        self._recording.close()
        shutil.rmtree(self._folder, ignore_errors=True)


def _unpack(path: Path, target: Path) -> None:
    """Whatever can be had of a file that ends too early is kept."""
    allowed = min(max(_ALWAYS_BYTES, _MAX_RATIO * path.stat().st_size), shutil.disk_usage(target.parent).free // 2)
    with path.open("rb") as file, target.open("wb") as unpacked:
        blocks = zstandard.ZstdDecompressor().read_to_iter(file, write_size=_BLOCK_BYTES)
        try:
            for block in blocks:
                if unpacked.tell() + len(block) > allowed:
                    raise DamagedRecordingError(
                        str(path), f"it unpacks to more than {allowed} bytes; unpack it with `zstd -d` if that is right"
                    )
                unpacked.write(block)
        except zstandard.ZstdError as error:
            if not unpacked.tell():
                raise DamagedRecordingError(str(path), "compressed data cannot be unpacked") from error
