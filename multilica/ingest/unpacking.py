# SPDX-License-Identifier: Apache-2.0
"""Compressed bytes, unpacked within bounds."""

from __future__ import annotations

import bz2

import lz4.frame
import zstandard
from isal.isal_zlib import crc32 as crc32_of

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


def unpack(compression: str, packed: bytes | memoryview, size: int, *, partial: bool = False) -> memoryview:
    """The `size` bytes that were compressed to `packed`; never more, whatever the data say.

    Args:
        compression: ``zstd``, ``lz4``, ``bz2``; empty or ``none`` where nothing is compressed.
        partial: take what can be had of data that end too early.

    Raises:
        ValueError: the size is impossible, or not that of the data; the text is a clause.
    """
    if size > MAX_UNPACKED_BYTES:
        raise ValueError(f"a record claims to unpack to {size} bytes; not more than {MAX_UNPACKED_BYTES} are believed")
    try:
        unpacked = _unpacked(compression, packed, size, partial=partial)
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


def _unpacked(compression: str, packed: bytes | memoryview, size: int, *, partial: bool) -> memoryview:
    if compression in UNCOMPRESSED:
        return memoryview(packed)
    if size == 0:
        return memoryview(b"")
    if compression == "zstd":
        return _unpacked_zstd(packed, size, partial=partial)
    if compression == "lz4":
        return memoryview(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size))
    if compression == "bz2":
        return memoryview(bz2.BZ2Decompressor().decompress(packed, max_length=size))
    raise ValueError(f"a record is compressed with '{compression[:16]}'; expected zstd, lz4 or bz2")


def _unpacked_zstd(packed: bytes | memoryview, size: int, *, partial: bool) -> memoryview:
    if partial:
        return memoryview(zstandard.ZstdDecompressor().stream_reader(packed).read(size))
    # The library sets aside what the frame states, whatever bound it is given.
    if _stated_size(packed) > size:
        raise ValueError(f"a record unpacks to {_stated_size(packed)} bytes, yet claims {size}")
    return memoryview(zstandard.ZstdDecompressor().decompress(packed, max_output_size=size))


def _stated_size(packed: bytes | memoryview) -> int:
    """What the header of a zstd frame says; -1 where it says nothing."""
    try:
        return int(zstandard.frame_content_size(packed))
    except zstandard.ZstdError as error:
        raise ValueError("compressed data cannot be unpacked") from error
