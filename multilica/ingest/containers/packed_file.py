# SPDX-License-Identifier: Apache-2.0
"""The reader of recordings that are compressed as a whole."""

import shutil
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import zstandard

from multilica.ingest.damage import DamagedRecordingError
from multilica.ingest.recording import Recording, WrappedRecording
from multilica.scratch import scratch_folder

_BLOCK_BYTES = 1 << 20
_MAX_RATIO = 200
_ALWAYS_BYTES = 64 << 20
"""Scans shrink to a half or a fifth; a file that grows to more than 200 times its size and this is malicious."""


def open_packed(path: Path, where: str, open_file: Callable[[Path, str], Recording]) -> Recording:
    """Unpack a file that was compressed with zstd into a temporary folder and open it there."""
    with ExitStack() as stack:
        unpacked = stack.enter_context(scratch_folder()) / path.stem
        _unpack(path, unpacked, where)
        return PackedRecording(open_file(unpacked, where), stack.pop_all())


class PackedRecording(WrappedRecording):
    """A recording in a temporary folder, which is removed when it is closed."""

    def __init__(self, recording: Recording, folder: ExitStack) -> None:
        super().__init__(recording)
        self.format = f"{recording.format}, zstd"
        self._folder = folder

    def close(self) -> None:
        """Close the recording and remove the unpacked file."""
        super().close()
        self._folder.close()


def _unpack(path: Path, target: Path, where: str) -> None:
    """Unpack a file; if it ends too early, unpack what it holds."""
    allowed = min(max(_ALWAYS_BYTES, _MAX_RATIO * path.stat().st_size), shutil.disk_usage(target.parent).free // 2)
    with path.open("rb") as file, target.open("wb") as unpacked:
        blocks = zstandard.ZstdDecompressor().read_to_iter(file, write_size=_BLOCK_BYTES)
        try:
            for block in blocks:
                if unpacked.tell() + len(block) > allowed:
                    raise DamagedRecordingError(
                        where, f"it unpacks to more than {allowed} bytes; unpack it with `zstd -d` if that is right"
                    )
                unpacked.write(block)
        except zstandard.ZstdError as error:
            if not unpacked.tell():
                raise DamagedRecordingError(where, "compressed data cannot be unpacked") from error
