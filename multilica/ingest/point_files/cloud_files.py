# SPDX-License-Identifier: Apache-2.0
"""Point files as a recording: one file per LiDAR, or a folder of frames per LiDAR."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest

from multilica.errors import UnreadableSourceError
from multilica.ingest.damage import damage_named
from multilica.ingest.formats import detect_format, named_format
from multilica.ingest.memory import memory_budget
from multilica.ingest.point_files import pcd, ply
from multilica.ingest.point_files.point_table import MAX_HEADER_BYTES
from multilica.ingest.recording import Messages, RawMessage, Topic
from multilica.ingest.remote.remote_file import SourceFile

_CLAIMED: Mapping[str, Callable[[bytes], int]] = {"pcd": pcd.claimed_bytes, "ply": ply.claimed_bytes}
"""Format -> function from the beginning of a file to the bytes that its header claims."""
_MAX_FILE_BYTES = 1 << 30
"""A file with thirty million points is a map, not a scan."""


@dataclass(frozen=True, slots=True)
class FrameFiles:
    """The files of one LiDAR, oldest first; `topic` is the name of the file or folder."""

    topic: str
    lidar: str
    files: tuple[SourceFile, ...]


class CloudFiles:
    """Point files as a recording whose topics are files or folders.

    Raises:
        UnreadableSourceError: a LiDAR's first file is empty or not a point file.
    """

    format = "point files"
    damage = ""
    is_indexed = True

    def __init__(self, lidars: Sequence[FrameFiles]) -> None:
        self._files = {lidar.topic: lidar.files for lidar in lidars}
        self.topics = tuple(sorted(map(_topic, lidars), key=lambda topic: topic.name))

    def span_ns(self, topics: Collection[str]) -> None:
        """Return None: point files have no time."""

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """Yield the first frame of each topic, then the second of each; `start_ns` is ignored."""
        del start_ns
        chosen = [topic for topic in self.topics if topic.name in topics]
        for row in zip_longest(*(self._files[topic.name] for topic in chosen)):
            for topic, path in zip(chosen, row, strict=True):
                if path is not None:
                    yield _message(topic, path)

    def close(self) -> None:
        """Do nothing: no file stays open."""


def _topic(lidar: FrameFiles) -> Topic:
    encoding = _encoding(lidar.files[0])
    return Topic(lidar.topic, encoding.upper(), encoding, len(lidar.files), lidar.lidar)


def _encoding(path: SourceFile) -> str:
    return (named_format(path) or detect_format(path)).name


def _message(topic: Topic, path: SourceFile) -> RawMessage:
    with damage_named(str(path)):
        size = path.stat().st_size
        if size > _MAX_FILE_BYTES:
            raise UnreadableSourceError(
                f"{path} has {size} bytes; expected one scan of at most {_MAX_FILE_BYTES} bytes."
            )
        encoding = _encoding(path)
        data = memory_budget().keep(_content(path, encoding, size))
        return RawMessage(topic.name, encoding.upper(), encoding, 0, data, str(path))


def _content(path: SourceFile, encoding: str, size: int) -> bytes:
    """Return the content of a file; of one with more bytes than its header claims, only the claimed ones."""
    with path.open("rb") as file:
        head = file.read(MAX_HEADER_BYTES)
        claimed = _CLAIMED[encoding](head) if encoding in _CLAIMED else size
        length = min(size, max(claimed, len(head)))
        memory_budget().require(length)
        file.seek(0)
        return file.read(length)
