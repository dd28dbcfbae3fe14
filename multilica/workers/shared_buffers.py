# SPDX-License-Identifier: Apache-2.0
"""Values in anonymous memory that processes share by file descriptor."""

import fcntl
import os
import pickle
import struct
from array import array
from collections.abc import Iterator, Sequence
from itertools import accumulate
from mmap import ACCESS_READ, mmap

# A buffer starts with a counter and the number of its sections; then come the lengths of the sections, and the
# sections: a pickle, and the arrays that it refers to.
_COUNTER = struct.Struct("=Q")
_LENGTHS_AT = 2 * _COUNTER.size
_ALIGNMENT = 64
_NEVER = 2**63


def pack(value: object) -> int:
    """Write a value to anonymous memory and return its file descriptor, which the caller closes.

    The memory is freed when no process holds the descriptor or a value that was read from it.
    """
    buffers: list[pickle.PickleBuffer] = []
    head = pickle.dumps(value, protocol=5, buffer_callback=buffers.append)
    sections = [memoryview(head), *(buffer.raw() for buffer in buffers)]
    lengths = array("Q", [section.nbytes for section in sections])
    descriptor = os.memfd_create("multilica")
    with open(descriptor, "wb", closefd=False) as memory:
        memory.write(array("Q", [0, len(sections)]).tobytes() + lengths.tobytes())
        for start, section in zip(_starts(lengths), sections, strict=True):
            memory.seek(start)
            memory.write(section)
    return descriptor


def unpack(descriptor: int) -> object:
    """Read the value that `pack` wrote; its arrays are read-only views of the shared memory."""
    memory = memoryview(mmap(descriptor, 0, access=ACCESS_READ))
    (count,) = _COUNTER.unpack_from(memory, _COUNTER.size)
    lengths = memory[_LENGTHS_AT : _LENGTHS_AT + count * _COUNTER.size].cast("Q")
    spans = zip(_starts(lengths), lengths, strict=True)
    head, *buffers = (memory[start : start + length] for start, length in spans)
    value: object = pickle.loads(head, buffers=buffers)  # noqa: S301 - written by a process of ours
    return value


def _starts(lengths: Sequence[int]) -> Iterator[int]:
    """Yield the start of each section, aligned for the fastest instructions."""
    first = _aligned(_LENGTHS_AT + len(lengths) * _COUNTER.size)
    return accumulate((_aligned(length) for length in lengths[:-1]), initial=first)


def _aligned(size: int) -> int:
    return -(-size // _ALIGNMENT) * _ALIGNMENT


def claim_next(descriptor: int) -> int:
    """Return how often this was called for the buffer before, by any process."""
    # A process that dies releases its lock.
    fcntl.lockf(descriptor, fcntl.LOCK_EX)
    (claimed,) = _COUNTER.unpack(os.pread(descriptor, _COUNTER.size, 0))
    os.pwrite(descriptor, _COUNTER.pack(claimed + 1), 0)
    fcntl.lockf(descriptor, fcntl.LOCK_UN)
    return int(claimed)


def end_claims(descriptor: int) -> None:
    """Let `claim_next` return a number beyond any from now on."""
    fcntl.lockf(descriptor, fcntl.LOCK_EX)
    os.pwrite(descriptor, _COUNTER.pack(_NEVER), 0)
    fcntl.lockf(descriptor, fcntl.LOCK_UN)
