# SPDX-License-Identifier: Apache-2.0
"""The registry of file formats.

To add a format, write its reader and add one entry to `FORMATS`.
"""

from dataclasses import dataclass
from typing import Literal

from multilica.documents import LFS_POINTER
from multilica.errors import UnreadableSourceError
from multilica.ingest.decompression import ZSTD_MAGIC, ZSTD_SKIPPED
from multilica.ingest.remote.remote_file import SourceFile

HEAD_BYTES = 1024
Content = Literal["recording", "cloud", "compressed"]
"""Content of a file: messages of several topics, one point cloud, or another file."""


@dataclass(frozen=True, slots=True)
class FileFormat:
    """A file format and its reader.

    Args:
        name: also the encoding of messages that are point files.
        title: the format in a sentence, for instance ``"a PCD file"``.
        suffixes: lower case; the longest one that a file's name ends in decides.
        content: what the reader yields.
        reader: module in `multilica.ingest`, imported on first use, with `open_file(path, where) -> Recording` for
            recordings or `decode_cloud(message) -> Cloud` for point clouds; `where` is the file's name for messages.
            `open_file` raises `DamagedRecordingError` if not a single message can be read.
        magic: first bytes, any of these; none if only the suffix tells.
        first_words: words that the first line that is no comment may start with.
        reads_ranges: the reader takes remote files; for other formats they are copied to disk first.
    """

    name: str
    title: str
    suffixes: tuple[str, ...]
    content: Content
    reader: str
    magic: tuple[bytes, ...] = ()
    first_words: tuple[bytes, ...] = ()
    reads_ranges: bool = False

    def matches(self, head: bytes) -> bool:
        """Return whether a file that begins with `head` has this format."""
        if head.startswith(self.magic) or not self.first_words:
            return head.startswith(self.magic)
        lines = (line.strip() for line in head.split(b"\n"))
        first = next((line for line in lines if line and not line.startswith(b"#")), b"")
        return first.upper().startswith(self.first_words)


FORMATS = {
    entry.name: entry
    for entry in (
        FileFormat(
            "mcap",
            "an MCAP file",
            (".mcap",),
            "recording",
            "containers.mcap_file",
            (b"\x89MCAP0\r\n",),
            reads_ranges=True,
        ),
        FileFormat(
            "sqlite3",
            "an SQLite file (ROS 2 bag)",
            (".db3",),
            "recording",
            "containers.ros2_sqlite",
            (b"SQLite format 3\0",),
        ),
        FileFormat(
            "ros1", "a ROS 1 bag", (".bag", ".bag.active"), "recording", "containers.ros1_bag", (b"#ROSBAG V2.0",)
        ),
        FileFormat("zstd", "compressed with zstd", (".zst", ".zstd"), "compressed", "", (ZSTD_MAGIC, *ZSTD_SKIPPED)),
        FileFormat("ply", "a PLY file", (".ply",), "cloud", "point_files.tables", (b"ply\n", b"ply\r")),
        FileFormat("las", "a LAS file", (".las", ".laz"), "cloud", "point_files.las", (b"LASF",)),
        FileFormat("npy", "a NumPy file", (".npy",), "cloud", "point_files.raw_arrays", (b"\x93NUMPY",)),
        FileFormat(
            "pcd", "a PCD file", (".pcd",), "cloud", "point_files.tables", (b"# .PCD",), (b"VERSION", b"FIELDS")
        ),
        FileFormat("kitti", "a float32 file (KITTI)", (".bin",), "cloud", "point_files.raw_arrays"),
        FileFormat("nuscenes", "a float32 file (nuScenes)", (".pcd.bin",), "cloud", "point_files.raw_arrays"),
    )
}
"""Name -> format; the first one that matches is taken."""
_NAMED = {suffix: entry for entry in FORMATS.values() for suffix in entry.suffixes if entry.content != "compressed"}

_UNSUPPORTED = (
    (b"#ROSBAG", "a ROS 1 bag of an old version; convert it with `rosbag migrate`"),
    (b"\x1f\x8b", "compressed with gzip; unpack it with `gunzip`"),
    (b"PK\x03\x04", "a zip archive; unpack it"),
    (b"RRF", "a Rerun recording; give the log that it was made from"),
)
"""First bytes of known formats that have no reader -> what to do instead."""


def named_format(path: SourceFile) -> FileFormat | None:
    """Return the format that the suffix of a file's name stands for; None if none, or if the file is compressed."""
    name = path.name.lower()
    return _NAMED.get(max((suffix for suffix in _NAMED if name.endswith(suffix)), key=len, default=""))


def named_content(path: SourceFile) -> Content | None:
    """Return what a file holds by its name, messages if it is compressed; None if the name does not tell."""
    named = named_format(path)
    return named.content if named else "recording" if name_unpacked(path.name) != path.name else None


def name_unpacked(name: str) -> str:
    """Return a file's name without the suffix of a compression."""
    suffix = next((suffix for suffix in FORMATS["zstd"].suffixes if name.lower().endswith(suffix)), "")
    return name[: len(name) - len(suffix)]


def detect_format(path: SourceFile, subject: str = "") -> FileFormat:
    """Return the format of a file by its first bytes.

    Args:
        subject: what the message says of; the path if empty.

    Raises:
        UnreadableSourceError: it is unknown or misnamed.
    """
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    try:
        return require_format(head, named_format(path))
    except ValueError as error:
        raise UnreadableSourceError(f"{subject or path} {error}.") from error


def require_format(head: bytes | memoryview, named: FileFormat | None) -> FileFormat:
    """Return the format of a file by its beginning; raise ValueError, with a predicate as its text, if none fits."""
    start = bytes(head[:HEAD_BYTES])
    if not start:
        raise ValueError("is empty")
    if start.startswith(LFS_POINTER):
        raise ValueError("is a pointer of Git LFS, not the file; get the file with `git lfs pull`")
    found = next((entry for entry in FORMATS.values() if entry.matches(start)), None)
    if found is None and named is not None and not named.magic:
        return named
    if found is None:
        raise ValueError(_unknown(start, named))
    if named not in (None, found):
        raise ValueError(f"is {found.title}, yet named like {named.title}; give it the right suffix")
    return found


def _unknown(start: bytes, named: FileFormat | None) -> str:
    for magic, what in _UNSUPPORTED:
        if start.startswith(magic):
            return f"is {what}"
    if named is not None:
        return f"is not {named.title}, although its name says so: its first bytes are {start[:8]!r}"
    known = "MCAP, ROS 2 bag, ROS 1 bag, PCD, PLY, LAS, LAZ, NPY"
    return f"has an unknown format; expected {known}; its first bytes are {start[:8]!r}"
