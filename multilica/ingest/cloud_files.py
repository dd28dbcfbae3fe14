# SPDX-License-Identifier: Apache-2.0
"""Point files: one per LiDAR, or a folder of frames per LiDAR."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import zip_longest

from multilica.errors import UnreadableSourceError
from multilica.ingest.damage import damage_named
from multilica.ingest.detect import detect_format, named_format
from multilica.ingest.recording import Message, Messages, Span, Topic
from multilica.ingest.remote_file import SourceFile

__all__ = ["CloudFiles", "FrameFiles", "open_frames"]


_MAX_FILE_BYTES = 1 << 30
"""Thirty million points are a map, no scan."""


@dataclass(frozen=True, slots=True)
class FrameFiles:
    """The files of one LiDAR.

    Args:
        topic: name of the file or folder.
        lidar: name of the LiDAR.
        files: its frames, oldest first.
    """

    topic: str
    lidar: str
    files: tuple[SourceFile, ...]


def open_frames(lidars: Sequence[FrameFiles]) -> CloudFiles:
    """Open point files.

    Raises:
        UnreadableSourceError: a LiDAR's first file is empty or no point file.
    """
    formats = [_format(lidar.files[0]) for lidar in lidars]
    topics = [
        Topic(lidar.topic, name.upper(), name, len(lidar.files), lidar.lidar)
        for lidar, name in zip(lidars, formats, strict=True)
    ]
    files = {lidar.topic: lidar.files for lidar in lidars}
    return CloudFiles(tuple(sorted(topics, key=lambda topic: topic.name)), files)


class CloudFiles:
    """Point files as a recording whose topics are files or folders."""

    format = "point files"
    damage = ""
    is_indexed = True

    def __init__(self, topics: tuple[Topic, ...], files: dict[str, tuple[SourceFile, ...]]) -> None:
        self.topics = topics
        self._files = files

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """None: point files have no time."""
        del topics
        return None

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """The first frame of each topic, then the second of each; `start_ns` has no meaning."""
        del start_ns
        chosen = [topic for topic in self.topics if topic.name in topics]
        for row in zip_longest(*(self._files[topic.name] for topic in chosen)):
            for topic, path in zip(chosen, row, strict=True):
                if path is not None:
                    yield _message(topic, path)

    def close(self) -> None:
        """Nothing stays open."""


def _format(path: SourceFile) -> str:
    return named_format(path) or detect_format(path)


def _message(topic: Topic, path: SourceFile) -> Message:
    with damage_named(str(path)):
        size = path.stat().st_size
        if size > _MAX_FILE_BYTES:
            raise UnreadableSourceError(
                f"{path} has {size} bytes; expected one scan, of not more than {_MAX_FILE_BYTES}."
            )
        encoding = _format(path)
        return Message(topic.name, encoding.upper(), encoding, 0, path.read_bytes(), str(path))
