# SPDX-License-Identifier: Apache-2.0
"""Decompression with limits."""

import bz2

import lz4.frame
import zstandard
from isal.isal_zlib import crc32 as crc32_of

from multilica.ingest.memory import memory_budget

MAX_UNPACKED_BYTES = 512 << 20
"""Limit of a chunk or message; no real recording has larger ones."""
MAX_RECORDS = 1 << 20
"""Limit of the records in a chunk."""
UNCOMPRESSED = ("", "none")
"""Names of compressions that mean none."""
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
ZSTD_SKIPPED = tuple(bytes([0x50 + number]) + b"\x2a\x4d\x18" for number in range(16))
"""First bytes of frames without data, as `pzstd` writes them."""


def unpack(compression: str, packed: bytes | memoryview, size: int, *, partial: bool = False) -> memoryview:
    """Decompress data to exactly `size` bytes, and never to more; if `partial`, to fewer if they end too early.

    Raises:
        ValueError: the size is impossible, or not that of the data; the text is a clause.
        MemoryLimitError: the size exceeds the memory budget of the ingest.
    """
    if size > MAX_UNPACKED_BYTES:
        raise ValueError(f"a record claims to unpack to {size} bytes; the limit is {MAX_UNPACKED_BYTES}")
    try:
        unpacked = _unpacked(compression, packed, size, partial=partial)
    except (zstandard.ZstdError, RuntimeError, OSError, EOFError) as error:
        raise ValueError("compressed data cannot be unpacked") from error
    if len(unpacked) != size and not partial:
        raise ValueError(f"a record unpacks to {len(unpacked)} bytes, but claims {size}")
    return unpacked


def unpack_zstd_message(packed: bytes | memoryview) -> memoryview:
    """Decompress a zstd frame that states its size; raise ValueError, with a clause as its text, if it is broken."""
    try:
        size = zstandard.frame_content_size(packed)
    except zstandard.ZstdError as error:
        raise ValueError("compressed data cannot be unpacked") from error
    if size < 0:
        raise ValueError("a compressed message does not state its size")
    return unpack("zstd", packed, size)


def require_checksum(data: bytes | memoryview, crc32: int) -> None:
    """Raise ValueError, with a clause as its text, if data contradict their CRC-32; 0 means that there is none."""
    if crc32 and crc32_of(data) != crc32:
        raise ValueError("a checksum does not match its data")


def _unpacked(compression: str, packed: bytes | memoryview, size: int, *, partial: bool) -> memoryview:
    if compression in UNCOMPRESSED:
        return memoryview(packed)
    if size == 0:
        return memoryview(b"")
    memory = memory_budget()
    memory.require(size)
    if compression == "zstd":
        return _unpacked_zstd(packed, size, partial=partial)
    if compression == "lz4":
        # The class around this function would copy `packed`.
        context = lz4.frame.create_decompression_context()
        return memory.keep(lz4.frame.decompress_chunk(context, packed, max_length=size)[0])
    if compression == "bz2":
        return memory.keep(bz2.BZ2Decompressor().decompress(packed, max_length=size))
    raise ValueError(f"a record is compressed with '{compression[:16]}'; expected zstd, lz4 or bz2")


def _unpacked_zstd(packed: bytes | memoryview, size: int, *, partial: bool) -> memoryview:
    stated_size = zstandard.frame_content_size(packed)
    if stated_size not in (-1, size) and not partial:
        raise ValueError(f"a record unpacks to {stated_size} bytes, but claims {size}")
    unpacked = memory_budget().empty(size)
    stream = zstandard.ZstdDecompressor().stream_reader(packed)
    length = stream.readinto(unpacked)
    if not partial and stream.read(1):
        raise ValueError(f"a record unpacks to more than the {size} bytes that it claims")
    return unpacked[:length]
