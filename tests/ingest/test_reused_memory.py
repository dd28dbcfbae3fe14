# SPDX-License-Identifier: Apache-2.0
"""Memory that is given out again, and never to two at once."""

from __future__ import annotations

import mmap

import numpy as np
import pytest

from multilica.ingest.reused_memory import ReusedMemory


def address_of(memory: memoryview) -> int:
    return int(np.frombuffer(memory, np.uint8).__array_interface__["data"][0])


def test_what_is_looked_at_stays_as_it_is() -> None:
    memory = ReusedMemory()
    held = []
    for number in range(8):
        whole = memory.of_size(1000)
        whole[:] = bytes([number]) * 1000
        held.append(np.ndarray((10,), np.uint8, whole[5:], 3, (2,)))
        del whole
    for number, part in enumerate(held):
        assert (part == number).all()


@pytest.mark.parametrize("size", [1 << 20, 5 << 20])
def test_what_nobody_looks_at_is_given_out_again(size: int) -> None:
    memory = ReusedMemory()
    first = memory.of_size(size)
    first_address = address_of(first)
    assert len(memory.of_size(1000)) == 1000
    del first
    second = memory.of_size(size - 10)
    assert (address_of(second), len(second)) == (first_address, size - 10)


def test_large_memory_is_what_was_asked_for() -> None:
    memory = ReusedMemory()
    held = memory.of_size((2 << 20) + 1)
    other = memory.of_size((2 << 20) + 1)
    held[:], other[:] = b"a" * len(held), b"b" * len(other)
    assert (len(held), bytes(held[-2:]), bytes(other[:2])) == ((2 << 20) + 1, b"aa", b"bb")


def test_a_kernel_without_huge_pages_gives_memory_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mmap, "MADV_HUGEPAGE", -1, raising=False)
    assert len(ReusedMemory().of_size(4 << 20)) == 4 << 20


def test_a_small_piece_does_not_hold_a_large_one() -> None:
    memory = ReusedMemory()
    first_address = address_of(memory.of_size(1 << 20))
    assert address_of(memory.of_size(1000)) != first_address
