# SPDX-License-Identifier: Apache-2.0
"""Small files that would fill the memory, and recordings with more in them than is asked for."""

from __future__ import annotations

import bz2
import struct
import tracemalloc
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.writer import CompressionType, Writer

from multilica.errors import UnreadableSourceError
from multilica.ingest import inspect_source, opening, read_snapshot
from multilica.ingest.containers import chunked
from multilica.ingest.decompression import MAX_UNPACKED_BYTES, unpack, unpack_zstd_message
from multilica.snapshot import LidarScans, Scan, Snapshot
from tests.ingest.support.format_writers import write_raw_mcap
from tests.ingest.support.recording_writers import (
    CLOUD,
    START_NS,
    assert_same_points,
    make_snapshot,
    write_mcap,
)

PACKERS: dict[str, Callable[[bytes], bytes]] = {
    "zstd": lambda data: zstandard.ZstdCompressor().compress(data),
    "lz4": lz4.frame.compress,
    "bz2": bz2.compress,
}
MOST_BYTES = 20 << 20


@contextmanager
def little_memory() -> Iterator[None]:
    """Fail where more is set aside; the peak of the process would hide what the test itself took before."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < MOST_BYTES
    finally:
        tracemalloc.stop()


def unpack_or_nothing(compression: str, packed: bytes, size: int) -> memoryview:
    try:
        return unpack(compression, packed, size)
    except ValueError:
        return memoryview(b"")


@pytest.mark.slow
@pytest.mark.parametrize("compression", PACKERS)
def test_never_more_is_unpacked_than_was_claimed(compression: str) -> None:
    packed = PACKERS[compression](bytes(100 << 20))
    assert len(packed) < 1 << 20
    with little_memory():
        assert len(unpack_or_nothing(compression, packed, 1000)) <= 1000


@pytest.mark.parametrize("compression", PACKERS)
def test_what_was_packed_comes_back(compression: str) -> None:
    data = bytes(range(256)) * 100
    packed = PACKERS[compression](data)
    assert bytes(unpack(compression, packed, len(data))) == data
    with pytest.raises(ValueError, match=r"cannot be unpacked|unpacks to \d+ bytes, but claims 25600"):
        unpack(compression, packed[: len(packed) // 2], len(data))
    with pytest.raises(ValueError, match=r"claims to unpack to 10000000000 bytes; the limit is 536870912"):
        unpack(compression, packed, 10**10)
    beginning = unpack(compression, packed[: len(packed) // 2], len(data), partial=True)
    assert bytes(beginning) == data[: len(beginning)]


def test_a_compression_that_nobody_knows() -> None:
    with pytest.raises(ValueError, match="is compressed with 'snappy'; expected zstd, lz4 or bz2"):
        unpack("snappy", b"123", 3)


def test_a_frame_that_lies_about_its_size() -> None:
    lying = b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", 1 << 50) + bytes(20)
    assert zstandard.frame_content_size(lying) == 1 << 50
    with pytest.raises(ValueError, match="claims to unpack to 1125899906842624 bytes"):
        unpack_zstd_message(lying)
    endless = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(100))
    assert zstandard.get_frame_parameters(endless).content_size == zstandard.CONTENTSIZE_UNKNOWN
    with pytest.raises(ValueError, match="does not state its size"):
        unpack_zstd_message(endless)


@pytest.mark.parametrize("claimed", [1 << 40, MAX_UNPACKED_BYTES, 100 << 20])
def test_a_chunk_that_is_a_bomb(tmp_path: Path, claimed: int) -> None:
    """A few kilobytes that claim more than they hold, or unpack to nothing but zeros."""
    write_mcap(make_snapshot(lidars=1), tmp_path / "a.mcap", chunk_size=1)
    content = (tmp_path / "a.mcap").read_bytes()
    packed = zstandard.ZstdCompressor().compress(bytes(100 << 20))
    body = struct.pack("<QQQII", START_NS, START_NS, claimed, 0, 4) + b"zstd" + struct.pack("<Q", len(packed)) + packed
    bomb = b"\x06" + struct.pack("<Q", len(body)) + body
    header_end = 8 + 9 + struct.unpack_from("<Q", content, 9)[0]
    (tmp_path / "a.mcap").write_bytes(content[:header_end] + bomb + content[header_end:-40])
    with pytest.raises(UnreadableSourceError, match=r"a\.mcap is damaged: ") as caught:
        read_snapshot(tmp_path / "a.mcap")
    if claimed == 100 << 20:
        assert "its records make no sense" in str(caught.value)


def test_a_packed_bag_that_is_a_bomb(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opening, "_ALWAYS_BYTES", 1 << 20)
    (tmp_path / "a.mcap.zstd").write_bytes(zstandard.ZstdCompressor().compress(b"\x89MCAP0\r\n" + bytes(50 << 20)))
    with pytest.raises(UnreadableSourceError, match=r"it unpacks to more than 1048576 bytes; unpack it with `zstd -d`"):
        read_snapshot(tmp_path / "a.mcap.zstd")


@pytest.mark.parametrize(("content", "predicate"), [(b"", "is empty"), (b"It rained.", "is not an MCAP file")])
def test_a_packed_file_of_something_else_bears_its_own_name(tmp_path: Path, content: bytes, predicate: str) -> None:
    path = tmp_path / "a.mcap.zstd"
    path.write_bytes(zstandard.ZstdCompressor().compress(content))
    with pytest.raises(UnreadableSourceError) as caught:
        read_snapshot(path)
    assert str(caught.value).startswith(f"{path} unpacks to a file that {predicate}")


@pytest.mark.slow
def test_an_attachment_is_not_loaded_and_its_name_is_no_path(tmp_path: Path) -> None:
    """In a recording without index, which is read from front to end."""
    snapshot = make_snapshot(lidars=1)
    write_mcap(snapshot, tmp_path / "whole.mcap")
    content = (tmp_path / "whole.mcap").read_bytes()
    with (tmp_path / "b.mcap").open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start()
        writer.add_attachment(0, 0, "../../escaped.txt", "text/plain", bytes(50 << 20))
        writer.finish()
    attachment = (tmp_path / "b.mcap").read_bytes()
    start = attachment.index(b"\x09", 17)
    length = 9 + struct.unpack_from("<Q", attachment, start + 1)[0]
    header_end = 17 + struct.unpack_from("<Q", content, 9)[0]
    joined = content[:header_end] + attachment[start : start + length] + content[header_end:-40]
    (tmp_path / "folder").mkdir()
    path = tmp_path / "folder" / "a.mcap"
    path.write_bytes(joined)
    with little_memory():
        found = read_snapshot(path)
    assert_same_points(found, snapshot)
    assert list(path.parent.iterdir()) == [path]
    assert not (tmp_path / "escaped.txt").exists()


def test_chunks_of_the_same_time_are_not_kept_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunked, "_MAX_WAITING_BYTES", 5000)
    scans = make_snapshot(lidars=1, frames=20).lidars[0].scans
    alike = [Scan(scan.points_m, START_NS, scan.intensity) for scan in scans]
    write_mcap(Snapshot((LidarScans("a", tuple(alike), topic="/a"),)), tmp_path / "a.mcap", chunk_size=1)
    assert len(read_snapshot(tmp_path / "a.mcap").lidars[0].scans) == 10


def test_a_flipped_bit_in_the_index_is_found(tmp_path: Path) -> None:
    """By the checksum in the footer; the file is then read from the front."""
    snapshot = make_snapshot()
    write_mcap(snapshot, tmp_path / "a.mcap")
    content = bytearray((tmp_path / "a.mcap").read_bytes())
    (summary_start,) = struct.unpack_from("<Q", content, len(content) - 28)
    assert zlib.crc32(content[summary_start:-12]) == struct.unpack_from("<I", content, len(content) - 12)[0]
    content[summary_start + 60] ^= 4
    (tmp_path / "a.mcap").write_bytes(content)
    assert inspect_source(tmp_path / "a.mcap").format == "MCAP without index"
    assert_same_points(read_snapshot(tmp_path / "a.mcap"), snapshot)


def test_a_point_file_that_is_a_map_is_not_loaded(tmp_path: Path) -> None:
    with (tmp_path / "map.las").open("wb") as file:
        file.write(b"LASF")
        file.truncate(30 << 30)
    with (
        little_memory(),
        pytest.raises(UnreadableSourceError, match=r"map\.las has 32212254720 bytes; expected one scan"),
    ):
        read_snapshot(tmp_path / "map.las")


def test_a_bag_with_message_compression_that_is_damaged(tmp_path: Path) -> None:
    packed = zstandard.ZstdCompressor().compress(bytes(1000))
    write_raw_mcap(iter([("/a", CLOUD, START_NS, packed[:8] + b"\xff" * 9)]), tmp_path / "a.mcap", "cdr")
    with pytest.raises(UnreadableSourceError, match="a scan of '/a' cannot be unpacked: compressed data cannot"):
        read_snapshot(tmp_path / "a.mcap")
