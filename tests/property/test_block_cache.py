# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import io

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from multilica.ingest import block_cache
from multilica.ingest.block_cache import BlockCache, BlockStream

DATA = bytes(range(251))
BLOCK = 8
reads = st.lists(st.tuples(st.integers(0, len(DATA)), st.integers(0, 120)), max_size=12)


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(block_cache, "BLOCK_BYTES", BLOCK)


@given(reads=reads)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_reads_give_the_bytes_of_the_file_and_no_block_comes_twice(reads: list[tuple[int, int]]) -> None:
    fetched: list[int] = []

    def fetch(start: int, end: int) -> bytes:
        fetched.extend(range(start // BLOCK, -(-end // BLOCK)))
        return DATA[start:end]

    stream, plain = BlockStream(BlockCache(fetch, len(DATA))), io.BytesIO(DATA)
    for place, size in reads:
        assert stream.seek(place) == plain.seek(place)
        assert stream.read(size) == plain.read(size)
        assert stream.tell() == plain.tell()
    assert len(fetched) == len(set(fetched))


@given(reads=reads)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_more_blocks_are_kept_than_allowed(reads: list[tuple[int, int]]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(block_cache, "_MAX_BLOCKS", 3)
        cache = BlockCache(lambda start, end: DATA[start:end], len(DATA))
        stream = BlockStream(cache)
        for place, size in reads:
            stream.seek(place)
            assert stream.read(size) == DATA[place : place + size]
            assert len(cache._blocks) <= 3


def test_neighbours_come_with_one_request() -> None:
    requests: list[tuple[int, int]] = []

    def fetch(start: int, end: int) -> bytes:
        requests.append((start, end))
        return DATA[start:end]

    cache = BlockCache(fetch, len(DATA))
    cache.read(17, 18)
    assert cache.read(3, 40) == DATA[3:40]
    assert requests == [(16, 24), (0, 16), (24, 40)]


def test_a_position_before_the_beginning_is_refused() -> None:
    stream = BlockStream(BlockCache(lambda start, end: DATA[start:end], len(DATA)))
    assert stream.seek(-1, io.SEEK_END) == len(DATA) - 1
    with pytest.raises(OSError, match="-1 bytes"):
        stream.seek(-1)
