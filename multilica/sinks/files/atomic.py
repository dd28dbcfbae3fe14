# SPDX-License-Identifier: Apache-2.0
"""Atomic writing of files."""

import errno
import fcntl
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path
from typing import BinaryIO

# Errors of a write itself do not name the file.
_OF_WRITING = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}


@contextmanager
def atomic_file(path: Path) -> Iterator[BinaryIO]:
    """Open a file that takes the name `path` when the block ends.

    Until then it has a hidden name in the same directory. It is removed if the block raises; after a kill, by the next
    `atomic_file` of this path. An OSError names `path`, which may not be a directory.
    """
    if not path.name or path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    for begun in begun_files(path):
        _remove_unlocked(begun)
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{threading.get_native_id()}.tmp")
    try:
        with _locked_file(temporary) as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
            temporary.replace(path)  # while the lock keeps other writers from removing it
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and (error.filename == str(temporary) or error.errno in _OF_WRITING):
            error.filename = str(path)
        raise


def _locked_file(path: Path) -> BinaryIO:
    """Open an empty file with a lock, which ends with the process."""
    while True:
        file = path.open("wb")
        with suppress(OSError):  # a file system without locks
            fcntl.flock(file, fcntl.LOCK_EX)
        if path.exists():
            return file
        file.close()  # another process removed it before it was locked


def _remove_unlocked(path: Path) -> None:
    with suppress(OSError), path.open("r+b") as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        path.unlink()


def begun_files(path: Path) -> list[Path]:
    """Return the unfinished files that killed processes left in `atomic_file`."""
    return sorted(path.parent.glob(f".{escape(path.name)}.*.tmp"))


def partial_path(path: Path) -> Path:
    """Return the name of a file until its run has ended: ``recording.rrd`` -> ``recording.partial.rrd``."""
    return path.with_name(f"{path.stem}.partial{path.suffix}")


def require_writable(path: Path) -> None:
    """Make the folder of a file that is written later, and raise the OSError that `atomic_file` would raise then."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.name or path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not os.access(path.parent, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))


def write_text_atomically(path: Path, text: str) -> None:
    """Write UTF-8 text atomically."""
    with atomic_file(path) as file:
        file.write(text.encode("utf-8"))
