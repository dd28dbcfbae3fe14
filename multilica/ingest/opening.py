# SPDX-License-Identifier: Apache-2.0
"""The opening of a source with the readers of its files."""

import heapq
import shutil
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from importlib import import_module
from itertools import combinations, islice, pairwise, zip_longest
from pathlib import Path
from typing import cast

import zstandard

from multilica.errors import UnreadableSourceError, UsageError, listed
from multilica.ingest.formats import FileFormat, detect_format, named_format
from multilica.ingest.locate import FrameFiles, Source, locate
from multilica.ingest.memory import memory_budget
from multilica.ingest.message_types import MESSAGE_TYPES, OUSTER, decode_cloud, is_cloud, is_installed
from multilica.ingest.point_files.tables import MAX_HEADER_BYTES, claimed_bytes
from multilica.ingest.recording import (
    DamagedRecordingError,
    Messages,
    RawMessage,
    Recording,
    Span,
    Topic,
    damage_named,
    joint_span,
    joint_topics,
)
from multilica.ingest.remote.remote_file import SourceFile, path_on_disk
from multilica.scratch import scratch_folder

_MAX_RATIO = 200
_ALWAYS_BYTES = 64 << 20
"""Scans shrink to a half or a fifth; a file that grows to more than 200 times its size and this is malicious."""

_MAX_TRIES = 4
"""Scans to try for the frame id; the first ones may be broken."""

_MAX_GAP_NS = 2 * 10**9
"""A recorder goes on with the next part of a bag at once."""

_MAX_FILE_BYTES = 1 << 30
"""A file with thirty million points is a map, not a scan."""


def open_source(source: Source) -> Recording:
    """Open the files of a source as one recording; raise UnreadableSourceError if none can be read."""
    if source.frames:
        return _CloudFiles(source.frames)
    if source.recorders:
        return _open_recorders(source.recorders)
    files = source.recordings
    is_whole_file = len(files) == 1 and not source.missing
    recording = _open_file(files[0]) if is_whole_file else _open_parts(source)
    types = {name for name, entry in MESSAGE_TYPES.items() if entry.requires == OUSTER}
    packets = [topic for topic in recording.topics if topic.message_type in types and topic.count]
    if not packets or not is_installed(OUSTER):
        return recording
    from multilica.ingest.messages.ouster_packets import with_turns

    return with_turns(recording, packets)


def _open_file(file: SourceFile) -> Recording:
    found = detect_format(file)
    if found.content == "compressed":
        return _open_packed(path_on_disk(file, "a compressed file"), str(file))
    return _read_by(found, file if found.reads_ranges else path_on_disk(file, found.title), str(file))


def _read_by(found: FileFormat, path: SourceFile, where: str) -> Recording:
    return cast(Recording, import_module(f"multilica.ingest.{found.reader}").open_file(path, where))


def _open_recorders(sources: tuple[Source, ...]) -> Recording:
    """Open recordings of the same moment; a topic in several of them is prefixed with its file: ``left.bag:/points``.

    Raises:
        UsageError: two of them hold the same LiDAR.
    """
    with ExitStack() as opened:
        parts = [(locate(source.label), opened.enter_context(closing(open_source(source)))) for source in sources]
        _require_disjoint(parts)
        recordings = [recording for _, recording in parts]
        counts = Counter(name for part in recordings for name in {topic.name for topic in part.topics})
        names = [
            {
                topic.name: topic.name if counts[topic.name] == 1 else f"{path.name}:{topic.name}"
                for topic in recording.topics
            }
            for path, recording in parts
        ]
        renamed = zip(recordings, names, strict=True)
        topics = [replace(topic, name=public[topic.name]) for part, public in renamed for topic in part.topics]
        title = " beside ".join(sorted({recording.format for recording in recordings}))
        sorted_topics = tuple(sorted(topics, key=lambda topic: topic.name))
        return _CombinedRecording(title, recordings, sorted_topics, opened.pop_all(), names=names)


def _open_parts(source: Source) -> Recording:
    files, missing = source.recordings, source.missing
    parts: list[Recording] = []
    errors: list[UnreadableSourceError] = []
    for file in files:
        try:
            parts.append(_open_file(file))
        except UnreadableSourceError as error:
            errors.append(error)
    if not parts:
        raise errors[0]
    damage = str(errors[0]).rstrip(".") if errors else ""
    if missing:
        damage = f"the bag lacks {missing[0]}, which its metadata.yaml names"
    title = f"{parts[0].format}, {'1 file' if len(parts) == 1 else f'{len(parts)} files'}"
    topics = joint_topics((topic, topic.count) for part in parts for topic in part.topics)
    with ExitStack() as opened:
        for part in parts:
            opened.enter_context(closing(part))
        if not source.is_listed:
            _require_in_turn(source.label, parts)
        if source.skipped is not None:
            _require_one_log(source, parts, source.skipped + len(errors))
        return _CombinedRecording(title, parts, topics, opened.pop_all(), damage)


def _require_in_turn(label: str, parts: Sequence[Recording]) -> None:
    """Raise UsageError if two parts were recorded side by side: a bag is split where one part ends."""
    spans = [part.span_ns([topic.name for topic in part.topics]) for part in parts]
    for one, other in combinations(filter(None, spans), 2):
        if 2 * (min(one[1], other[1]) - max(one[0], other[0])) > min(one[1] - one[0], other[1] - other[0]):
            raise UsageError(
                f"{label} holds {len(parts)} recordings of the same time, which are no parts of one bag; give them one "
                "by one if each holds another LiDAR, else one of them."
            )


def _require_one_log(source: Source, parts: Sequence[Recording], absent: int) -> None:
    """Raise UsageError if the time between parts is longer than the absent ones explain: they are several logs."""
    spans = sorted(span for part in parts if (span := part.span_ns([topic.name for topic in part.topics])))
    longest_ns = max((last_ns - first_ns for first_ns, last_ns in spans), default=0)
    for one, other in pairwise(spans):
        if other[0] - one[1] > _MAX_GAP_NS + 2 * absent * longest_ns:
            raise UsageError(
                f"{source.label} holds {len(parts)} recordings ({listed([file.name for file in source.recordings])}) "
                f"with {(other[0] - one[1]) / 1e9:.1f} s between two of them, which are no parts of one bag; give one "
                "of them by its name, or all of them if they are of one rig."
            )


def _open_packed(path: Path, where: str) -> Recording:
    """Unpack a file that was compressed with zstd into a temporary folder and open it there."""
    with ExitStack() as opened:
        unpacked = opened.enter_context(scratch_folder()) / path.stem
        _unpack(path, unpacked, where)
        found = detect_format(unpacked, f"{where} unpacks to a file that")
        if found.content != "recording":
            raise UnreadableSourceError(f"{where} does not unpack to a recording; unpack it with `zstd -d`.")
        part = opened.enter_context(closing(_read_by(found, unpacked, where)))
        return _CombinedRecording(f"{part.format}, zstd", [part], part.topics, opened.pop_all())


def _unpack(path: Path, target: Path, where: str) -> None:
    """Unpack a file; if it ends too early, unpack what it holds."""
    allowed = min(max(_ALWAYS_BYTES, _MAX_RATIO * path.stat().st_size), shutil.disk_usage(target.parent).free // 2)
    with path.open("rb") as file, target.open("wb") as unpacked:
        # Parallel writers and `cat` make several frames, some without data.
        stream = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
        try:
            while block := stream.read(1 << 20):
                if unpacked.tell() + len(block) > allowed:
                    raise DamagedRecordingError(
                        where, f"it unpacks to more than {allowed} bytes; unpack it with `zstd -d` if that is right"
                    )
                unpacked.write(block)
        except zstandard.ZstdError as error:
            if not unpacked.tell():
                raise DamagedRecordingError(where, "compressed data cannot be unpacked") from error


class _CombinedRecording(Recording):
    """Several open recordings as one.

    Args:
        opened: closes them.
        names: topic in the recording -> topic, for recordings of the same moment; None for parts of one recording,
            oldest first.
    """

    def __init__(
        self,
        title: str,
        parts: Sequence[Recording],
        topics: tuple[Topic, ...],
        opened: ExitStack,
        damage: str = "",
        names: Sequence[Mapping[str, str]] | None = None,
    ) -> None:
        self.format = title
        self.topics = topics
        self.damage = damage or next((part.damage for part in parts if part.damage), "")
        self.is_indexed = all(part.is_indexed for part in parts)
        self._opened = opened
        self._are_beside = names is not None
        self._parts = list(
            zip(parts, names or [{topic.name: topic.name for topic in topics}] * len(parts), strict=True)
        )

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Return the span over all recordings."""
        return joint_span(part.span_ns(_own(names, topics)) for part, names in self._parts)

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """Yield messages by log time, or part after part; raise damage of one recording after the others have ended."""
        damage: list[DamagedRecordingError] = []
        if self._are_beside:
            chosen = [(part, names) for part, names in self._parts if _own(names, topics)]
            streams = [_renamed(part, names, topics, start_ns, damage) for part, names in chosen]
            yield from heapq.merge(*streams, key=lambda message: message.log_time_ns)
        else:
            for part, names in self._parts:
                yield from _renamed(part, names, topics, start_ns, damage)
        if damage:
            raise damage[0]

    def close(self) -> None:
        """Close all recordings."""
        self._opened.close()


def _own(names: Mapping[str, str], topics: Collection[str]) -> list[str]:
    """Return the names of topics within their recording."""
    return [own for own, public in names.items() if public in topics]


def _renamed(
    part: Recording,
    names: Mapping[str, str],
    topics: Collection[str],
    start_ns: int,
    damage: list[DamagedRecordingError],
) -> Iterator[RawMessage]:
    try:
        for message in part.messages(_own(names, topics), start_ns):
            yield message if names[message.topic] == message.topic else replace(message, topic=names[message.topic])
    except DamagedRecordingError as error:
        damage.append(error)


def _require_disjoint(parts: Sequence[tuple[SourceFile, Recording]]) -> None:
    """Refuse two recordings of one LiDAR: of the same name, or with the same frame id on the same topic."""
    holders: dict[tuple[str, str], SourceFile] = {}
    for path, recording in parts:
        clouds = [topic for topic in recording.topics if is_cloud(topic) and topic.count]
        for key in sorted({_identity(recording, topic) for topic in clouds}):
            if key in holders:
                raise UsageError(
                    f"{holders[key]} and {path} both hold the LiDAR '{key[1] or key[0]}'; recordings of one snapshot "
                    "must hold different LiDARs."
                )
            holders[key] = path


def _identity(recording: Recording, topic: Topic) -> tuple[str, str]:
    """Return the topic and the frame id of a LiDAR; only its name if the recording names it."""
    if topic.lidar:
        return "", topic.lidar
    with suppress(DamagedRecordingError), closing(recording.messages([topic.name])) as messages:
        for message in islice(messages, _MAX_TRIES):
            with suppress(UnreadableSourceError):
                return topic.name, decode_cloud(message).frame_id
    return topic.name, ""


class _CloudFiles(Recording):
    """Point files as a recording whose topics are files or folders.

    Raises:
        UnreadableSourceError: a LiDAR's first file is empty or not a point file.
    """

    format = "point files"

    def __init__(self, lidars: Sequence[FrameFiles]) -> None:
        self._files = {lidar.topic: lidar.files for lidar in lidars}
        named = ((lidar, _encoding(lidar.files[0])) for lidar in lidars)
        topics = (Topic(each.topic, name.upper(), name, len(each.files), each.lidar) for each, name in named)
        self.topics = tuple(sorted(topics, key=lambda topic: topic.name))

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """Yield the first frame of each topic, then the second of each; `start_ns` is ignored."""
        del start_ns
        chosen = [topic for topic in self.topics if topic.name in topics]
        for row in zip_longest(*(self._files[topic.name] for topic in chosen)):
            for topic, path in zip(chosen, row, strict=True):
                if path is not None:
                    yield _message(topic, path)


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
        with path.open("rb") as file:
            head = file.read(MAX_HEADER_BYTES)
            # A file with more bytes than its header claims is only read up to these.
            claimed = claimed_bytes(encoding, head)
            length = size if claimed is None else min(size, max(claimed, len(head)))
            memory_budget().require(length)
            file.seek(0)
            data = memory_budget().keep(file.read(length))
        return RawMessage(topic.name, encoding.upper(), encoding, 0, data, str(path))
