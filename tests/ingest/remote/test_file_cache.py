# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import io
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from multilica.ingest.remote import file_cache
from multilica.ingest.remote.file_cache import CachedStream, FileCache

DATA = bytes(range(251))
BLOCK = 8


@pytest.fixture(autouse=True, scope="module")
def small_blocks() -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(file_cache, "BLOCK_BYTES", BLOCK)
        yield


@given(reads=st.lists(st.tuples(st.integers(0, len(DATA)), st.integers(0, 120)), max_size=12))
@settings(deadline=None)
def test_reads_are_exact_and_load_no_block_twice(reads: list[tuple[int, int]]) -> None:
    fetched: list[int] = []

    def fetch(start: int, end: int) -> bytes:
        fetched.extend(range(start // BLOCK, -(-end // BLOCK)))
        return DATA[start:end]

    with TemporaryDirectory() as folder:
        stream, plain = CachedStream(FileCache(fetch, len(DATA), Path(folder) / "a")), io.BytesIO(DATA)
        for place, size in reads:
            assert stream.seek(place) == plain.seek(place)
            assert stream.read(size) == plain.read(size)
            assert stream.tell() == plain.tell()
    assert len(fetched) == len(set(fetched))


def test_neighbours_come_with_one_request(tmp_path: Path) -> None:
    requests: list[tuple[int, int]] = []

    def fetch(start: int, end: int) -> bytes:
        requests.append((start, end))
        return DATA[start:end]

    cache = FileCache(fetch, len(DATA), tmp_path / "a")
    cache.read(17, 18)
    assert cache.read(3, 39) == DATA[3:39]
    assert requests == [(16, 24), (0, 16), (24, 40)]


def test_a_failed_request_leaves_no_zeros(tmp_path: Path) -> None:
    failures = [OSError("lost")]

    def fetch(start: int, end: int) -> bytes:
        if start > 0 and failures:
            raise failures.pop()
        return DATA[start:end]

    cache = FileCache(fetch, len(DATA), tmp_path / "a")
    assert cache.read(0, 4) == DATA[:4]
    with pytest.raises(OSError, match="lost"):
        cache.read(0, 100)
    assert cache.read(0, 100) == DATA[:100]


def test_a_file_that_is_on_disk_is_not_fetched(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(DATA)
    cache = FileCache(lambda *_: pytest.fail("fetched"), len(DATA), tmp_path / "a", range(len(DATA) // BLOCK + 1))
    assert cache.read(0, 1000) == DATA
    assert FileCache(lambda *_: b"", 0, tmp_path / "b").read(0, 10) == b""
