# SPDX-License-Identifier: Apache-2.0
"""Memory that is given out again, and never to two at once."""

from __future__ import annotations

import numpy as np

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


def test_what_nobody_looks_at_is_given_out_again() -> None:
    memory = ReusedMemory()
    first = memory.of_size(1 << 20)
    first_address = address_of(first)
    assert len(memory.of_size(1000)) == 1000
    del first
    second = memory.of_size((1 << 20) - 10)
    assert (address_of(second), len(second)) == (first_address, (1 << 20) - 10)


def test_a_small_piece_does_not_hold_a_large_one() -> None:
    memory = ReusedMemory()
    first_address = address_of(memory.of_size(1 << 20))
    assert address_of(memory.of_size(1000)) != first_address
