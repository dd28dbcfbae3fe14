# SPDX-License-Identifier: Apache-2.0
"""Files that appear under their name only when they are whole."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from glob import escape
from pathlib import Path
from typing import BinaryIO

__all__ = ["atomic_file", "begun_files", "partial_path", "write_text_atomically"]


@contextmanager
def atomic_file(path: Path) -> Iterator[BinaryIO]:
    """A file to write to that takes the name `path` when the block ends.

    It lies in the same directory under a hidden name until then, and is removed if the block raises.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def begun_files(path: Path) -> list[Path]:
    """What processes that were killed left of a file that they were writing as `atomic_file`."""
    return sorted(path.parent.glob(f".{escape(path.name)}.*.tmp"))


def partial_path(path: Path) -> Path:
    """What a file of a run is called until the run has ended: ``recording.rrd`` -> ``recording.partial.rrd``."""
    return path.with_name(f"{path.stem}.partial{path.suffix}")


def write_text_atomically(path: Path, text: str) -> None:
    """Write UTF-8 text so that nobody ever sees half of it."""
    with atomic_file(path) as file:
        file.write(text.encode("utf-8"))
