# SPDX-License-Identifier: Apache-2.0
"""Settings of the C library's allocator for processes that make many large arrays."""

import ctypes
from contextlib import suppress

# From malloc.h of glibc.
_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3
_MIB = 1 << 20


def keep_freed_memory() -> None:
    """Let this process use the memory of freed arrays again, instead of asking the system for each large one.

    The system clears and hands out page by page, which takes 3 % of the time of a calibration. If the C library is
    not glibc, nothing is changed.
    """
    with suppress(OSError, AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        for setting, size in ((_MMAP_THRESHOLD, 8 * _MIB), (_TRIM_THRESHOLD, 256 * _MIB), (_TOP_PAD, 16 * _MIB)):
            mallopt(setting, size)
