# SPDX-License-Identifier: Apache-2.0
"""What a file is, by its first bytes."""

from __future__ import annotations

from multilica.errors import UnreadableSourceError
from multilica.ingest.remote_file import SourceFile

__all__ = [
    "CLOUD_SUFFIXES",
    "PACKED",
    "PACKED_SUFFIXES",
    "RECORDING_SUFFIXES",
    "TITLES",
    "detect_format",
    "named_format",
    "require_format",
]

HEAD_BYTES = 1024

RECORDING_SUFFIXES = {".mcap": "mcap", ".db3": "sqlite3", ".bag": "ros1"}
CLOUD_SUFFIXES = {".pcd": "pcd", ".ply": "ply", ".las": "las", ".laz": "las", ".bin": "kitti", ".npy": "npy"}
FILE_SUFFIXES = RECORDING_SUFFIXES | CLOUD_SUFFIXES

_DOUBLE_SUFFIXES = ((".pcd.bin", "nuscenes"), (".bag.active", "ros1"))
"""A file of nuScenes, which holds no PCD; what a recorder of ROS 1 leaves that was killed."""

PACKED = "zstd"
"""The format of a recording that is compressed as a whole."""
PACKED_SUFFIXES = (".zst", ".zstd")

TITLES = {
    "mcap": "an MCAP file",
    "sqlite3": "an SQLite file (ROS 2 bag)",
    "ros1": "a ROS 1 bag",
    "pcd": "a PCD file",
    "ply": "a PLY file",
    "las": "a LAS file",
    "npy": "a NumPy file",
    "kitti": "a file of float32 (KITTI)",
    "nuscenes": "a file of float32 (nuScenes)",
    PACKED: "compressed with zstd",
}
_WITHOUT_MAGIC = ("kitti", "nuscenes")
_MAGIC = (
    (b"\x89MCAP0\r\n", "mcap"),
    (b"SQLite format 3\0", "sqlite3"),
    (b"#ROSBAG V2.0", "ros1"),
    (b"ply\n", "ply"),
    (b"ply\r", "ply"),
    (b"LASF", "las"),
    (b"\x93NUMPY", "npy"),
    (b"\x28\xb5\x2f\xfd", PACKED),
)
_PCD_KEYWORDS = (b"VERSION", b"FIELDS")
_FOREIGN = (
    (b"#ROSBAG", "a ROS 1 bag of an old version; convert it with `rosbag migrate`"),
    (b"\x1f\x8b", "compressed with gzip; unpack it with `gunzip`"),
    (b"PK\x03\x04", "a zip archive; unpack it"),
    (b"RRF", "a Rerun recording; give the log that it was made from"),
)


def named_format(path: SourceFile) -> str | None:
    """The format that a file's name promises; None if it promises none."""
    name = path.name.lower()
    of_two_parts = (found for ends, found in _DOUBLE_SUFFIXES if name.endswith(ends))
    return next(of_two_parts, FILE_SUFFIXES.get(path.suffix.lower()))


def detect_format(path: SourceFile) -> str:
    """``mcap``, ``sqlite3``, ``ros1``, ``pcd``, ``ply``, ``las``, ``npy``, ``kitti``, ``nuscenes`` or ``zstd``.

    Raises:
        UnreadableSourceError: empty, of no format that is read here, or of another one than its name says.
    """
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    try:
        return require_format(head, named_format(path))
    except ValueError as error:
        raise UnreadableSourceError(f"{path} {error}.") from error


def require_format(head: bytes | memoryview, named: str | None) -> str:
    """The format that begins with these bytes.

    Args:
        head: at least the first `HEAD_BYTES` bytes, or all.
        named: the format that the file's name promises; None if it promises none.

    Raises:
        ValueError: empty, of no format that is read here, or not as named; the text is a predicate.
    """
    start = bytes(head[:HEAD_BYTES])
    if not start:
        raise ValueError("is empty: it has no bytes at all")
    found = _format_of(start)
    if found is None and named in _WITHOUT_MAGIC:
        return named
    if found is None:
        raise ValueError(_unknown(start, named))
    if named not in (None, found):
        raise ValueError(f"is {TITLES[found]}, yet named like {TITLES[named]}; give it the right suffix")
    return found


def _format_of(start: bytes) -> str | None:
    for magic, name in _MAGIC:
        if start.startswith(magic):
            return name
    return "pcd" if _is_pcd(start) else None


def _is_pcd(start: bytes) -> bool:
    lines = [line.strip() for line in start.split(b"\n")]
    content = [line for line in lines if line and not line.startswith(b"#")]
    return lines[0].startswith(b"# .PCD") or (bool(content) and content[0].upper().startswith(_PCD_KEYWORDS))


def _unknown(start: bytes, named: str | None) -> str:
    for magic, what in _FOREIGN:
        if start.startswith(magic):
            return f"is {what}"
    if named is not None:
        return f"is not {TITLES[named]}, although its name says so: its first bytes are {start[:8]!r}"
    known = "MCAP, ROS 2 bag, ROS 1 bag, PCD, PLY, LAS, LAZ, NPY"
    return f"is of no format that is read here ({known}): its first bytes are {start[:8]!r}"
