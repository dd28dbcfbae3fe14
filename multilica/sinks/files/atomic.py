# SPDX-License-Identifier: Apache-2.0
"""Atomic writing of files."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from glob import escape
from pathlib import Path
from typing import BinaryIO

__all__ = ["atomic_file", "begun_files", "partial_path", "write_text_atomically"]


@contextmanager
def atomic_file(path: Path) -> Iterator[BinaryIO]:
    """Open a file that takes the name `path` when the block ends.

    Until then it has a hidden name in the same directory. It is removed if the block raises.
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
    """Return the unfinished files that killed processes left in `atomic_file`."""
    return sorted(path.parent.glob(f".{escape(path.name)}.*.tmp"))


def partial_path(path: Path) -> Path:
    """Return the name of a file until its run has ended: ``recording.rrd`` -> ``recording.partial.rrd``."""
    return path.with_name(f"{path.stem}.partial{path.suffix}")


def write_text_atomically(path: Path, text: str) -> None:
    """Write UTF-8 text atomically."""
    with atomic_file(path) as file:
        file.write(text.encode("utf-8"))
