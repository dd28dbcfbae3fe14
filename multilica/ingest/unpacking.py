# SPDX-License-Identifier: Apache-2.0
"""Compressed bytes, unpacked within bounds."""

from __future__ import annotations

import bz2

import lz4.frame
import zstandard
from isal.isal_zlib import crc32 as crc32_of

from multilica.ingest.reused_memory import ReusedMemory

__all__ = [
    "MAX_RECORDS",
    "MAX_UNPACKED_BYTES",
    "UNCOMPRESSED",
    "ZSTD_MAGIC",
    "require_checksum",
    "unpack",
    "unpack_zstd_message",
]

MAX_UNPACKED_BYTES = 512 << 20
"""No chunk and no message of a sane recording is larger; what claims more is not unpacked."""

MAX_RECORDS = 1 << 20
"""Records of a chunk; with more of them, they are too short to be any."""

UNCOMPRESSED = ("", "none")
"""What stands where a compression is named."""

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


def unpack(
    compression: str,
    packed: bytes | memoryview,
    size: int,
    memory: ReusedMemory | None = None,
    *,
    partial: bool = False,
) -> memoryview:
    """The `size` bytes that were compressed to `packed`; never more, whatever the data say.

    Args:
        compression: ``zstd``, ``lz4``, ``bz2``; empty or ``none`` where nothing is compressed.
        memory: to unpack to, as far as the library allows it; fresh memory if None.
        partial: take what can be had of data that end too early.

    Raises:
        ValueError: the size is impossible, or not that of the data; the text is a clause.
    """
    if size > MAX_UNPACKED_BYTES:
        raise ValueError(f"a record claims to unpack to {size} bytes; not more than {MAX_UNPACKED_BYTES} are believed")
    try:
        unpacked = _unpacked(compression, packed, size, memory or ReusedMemory(), partial=partial)
    except (zstandard.ZstdError, RuntimeError, OSError, EOFError) as error:
        raise ValueError("compressed data cannot be unpacked") from error
    if len(unpacked) != size and not partial:
        raise ValueError(f"a record unpacks to {len(unpacked)} bytes, yet claims {size}")
    return unpacked


def unpack_zstd_message(packed: bytes | memoryview) -> memoryview:
    """The content of a zstd frame that tells its own size.

    Raises:
        ValueError: it is too large, tells no size, or is broken; the text is a clause.
    """
    size = _stated_size(packed)
    if size < 0:
        raise ValueError("a compressed message does not say how large it is")
    return unpack("zstd", packed, size)


def require_checksum(data: bytes | memoryview, crc32: int) -> None:
    """Check data against their CRC-32; 0 stands for none.

    Raises:
        ValueError: they differ; the text is a clause.
    """
    if crc32 and crc32_of(data) != crc32:
        raise ValueError("a checksum does not match its data")


def _unpacked(
    compression: str, packed: bytes | memoryview, size: int, memory: ReusedMemory, *, partial: bool
) -> memoryview:
    if compression in UNCOMPRESSED:
        return memoryview(packed)
    if size == 0:
        return memoryview(b"")
    if compression == "zstd":
        return _unpacked_zstd(packed, size, memory, partial=partial)
    if compression == "lz4":
        # The class around this function makes `packed` anew.
        context = lz4.frame.create_decompression_context()
        return memoryview(lz4.frame.decompress_chunk(context, packed, max_length=size)[0])
    if compression == "bz2":
        return memoryview(bz2.BZ2Decompressor().decompress(packed, max_length=size))
    raise ValueError(f"a record is compressed with '{compression[:16]}'; expected zstd, lz4 or bz2")


def _unpacked_zstd(packed: bytes | memoryview, size: int, memory: ReusedMemory, *, partial: bool) -> memoryview:
    stated_size = _stated_size(packed)
    if stated_size not in (-1, size) and not partial:
        raise ValueError(f"a record unpacks to {stated_size} bytes, yet claims {size}")
    unpacked = memory.of_size(size)
    stream = zstandard.ZstdDecompressor().stream_reader(packed)
    held = stream.readinto(unpacked)
    if not partial and stream.read(1):
        raise ValueError(f"a record unpacks to more than the {size} bytes that it claims")
    return unpacked[:held]


def _stated_size(packed: bytes | memoryview) -> int:
    """What the header of a zstd frame says; -1 where it says nothing."""
    try:
        return int(zstandard.frame_content_size(packed))
    except zstandard.ZstdError as error:
        raise ValueError("compressed data cannot be unpacked") from error
