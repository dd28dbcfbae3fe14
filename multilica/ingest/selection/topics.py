# SPDX-License-Identifier: Apache-2.0
"""The topics that are used as LiDARs."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from contextlib import closing, suppress
from fnmatch import fnmatchcase

from multilica.config import IngestConfig
from multilica.errors import ConfigError, UnfitSnapshotError, UnknownNameError, listed
from multilica.ingest.message_types import COMPRESSED_CLOUDS, is_cloud, is_packets, obstacle
from multilica.ingest.recording import DamagedRecordingError, Messages, Recording, Span, Topic, normal_type
from multilica.pointcloud2 import MERGED_TOPIC

_COMMON_WORDS = re.compile(r"lidar|packets?|scans?|raw|ex|points?(cloud)?2?|cloud2?|[/_0-9]")
"""Parts of topic names that tell what is sent rather than by which LiDAR."""
_LONGEST_LOG_NS = 24 * 3600 * 10**9
"""In longer ones, a gap of most of the time is a clock that was set."""


def choose_topics(
    recording: Recording, asked_for: Mapping[str, str], label: str, only: Sequence[str] = ()
) -> dict[str, str]:
    """Return topic -> name of the LiDAR, empty to name it after its frame id.

    A topic may be given by its name, by a shell pattern (``/lidar_*/points``), or by its message type. If none is
    given, every point cloud topic with messages is used. `MERGED_TOPIC` is used only if it is given by its name.

    Args:
        asked_for: LiDAR name -> topic, as in `ingest.topics`.
        only: topics without names for their LiDARs, as in `ingest.only`.

    Raises:
        UnfitSnapshotError: the recording has no point clouds, or a topic given by name cannot be read.
        UnknownNameError: there is no such point cloud topic.
        ConfigError: a topic with two names, a name with two topics, or an empty name.
    """
    named = {*only, *asked_for.values()}
    found = (topic for topic in recording.topics if is_cloud(topic))
    clouds = {topic.name: topic for topic in found if topic.name != MERGED_TOPIC or topic.name in named}
    if not any(topic.count for topic in clouds.values()):
        raise UnfitSnapshotError(_no_clouds(recording, label))
    if not asked_for and not only:
        return {name: topic.lidar for name, topic in clouds.items() if topic.count and not _is_twin(topic, clouds)}
    for topic in recording.topics:
        if topic.name in named and topic.name not in clouds and (content := obstacle(topic)):
            raise UnfitSnapshotError(f"In {label}, '{topic.name}' holds {content}.")
    chosen: dict[str, str] = {}
    for pattern in only:
        chosen |= {name: clouds[name].lidar for name in _matching(pattern, clouds, label)}
    return chosen | _named(asked_for, clouds, label)


def named_topics(given: Mapping[str, str], config: IngestConfig) -> set[str]:
    """Return the chosen topics that the configuration names, or gives a name: no patterns for several."""
    asked_for = {*config.only, *config.topics.values()}
    return {topic for topic, name in given.items() if topic in asked_for or name in config.topics}


class ChosenRecording(Recording):
    """A recording as if no clouds but those on the chosen topics had been recorded, nor latched ones, as of a map."""

    def __init__(self, recording: Recording, topics: Collection[str]) -> None:
        self._recording = recording
        self.format, self.damage, self.is_indexed = recording.format, recording.damage, recording.is_indexed
        chosen = [topic for topic in recording.topics if is_cloud(topic) and topic.name in topics]
        repeated = [topic for topic in chosen if topic.count > 1]
        self.topics = (*(repeated or chosen), *(topic for topic in recording.topics if not is_cloud(topic)))

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Return when these topics begin and end; None without messages or without time."""
        return self._recording.span_ns(topics)

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """Yield the messages on these topics, as the whole recording."""
        return self._recording.messages(topics, start_ns)


def cloud_span(recording: Recording) -> Span | None:
    """Return the log times of the first and the last cloud, without those before the clock was set; None without time.

    Clocks without a battery begin in 1970 or when their system was built.
    """
    topics = {topic.name for topic in recording.topics if is_cloud(topic)}
    span = recording.span_ns(topics)
    while span is not None and span[1] - span[0] > _LONGEST_LOG_NS:
        middle_ns = (span[0] + span[1]) // 2
        with suppress(DamagedRecordingError), closing(recording.messages(topics, middle_ns)) as messages:
            first = next(messages, None)
            if first is not None and first.log_time_ns - middle_ns > (span[1] - span[0]) // 4:
                span = first.log_time_ns, span[1]
                continue
        break
    return span


def unread_notes(recording: Recording) -> list[str]:
    """Return notes on topics with points that cannot be read, or need not be, and what to do about them."""
    clouds = {topic.name: topic for topic in recording.topics if is_cloud(topic)}
    topics: dict[str, list[str]] = defaultdict(list)
    for topic in recording.topics:
        if topic.count and (content := _as_clouds(topic, clouds) or obstacle(topic)):
            topics[content].append(f"'{topic.name}'")
    return [f"{listed(names)} {'hold' if len(names) > 1 else 'holds'} {text}." for text, names in topics.items()]


def _as_clouds(topic: Topic, clouds: Mapping[str, Topic]) -> str:
    """Return the content of a topic whose points are recorded as clouds, too; empty for every other topic."""
    if _is_twin(topic, clouds):
        return "packets of LiDARs whose clouds are recorded, too, and are used"
    # A transport of point_cloud_transport adds its name to that of the topic: /points/draco.
    original = clouds.get(topic.name.rpartition("/")[0])
    is_copy = topic.message_type in COMPRESSED_CLOUDS and original is not None and original.count
    return "compressed copies of clouds that are recorded, too, and are used" if is_copy else ""


def _named(asked_for: Mapping[str, str], clouds: Mapping[str, Topic], label: str) -> dict[str, str]:
    found: dict[str, str] = {}
    for name, pattern in asked_for.items():
        if not name.strip():
            raise ConfigError(f"In ingest.topics, the topic '{pattern}' has an empty name; expected NAME=/topic.")
        topic, *more = _matching(pattern, clouds, label)
        if more:
            raise ConfigError(
                f"In ingest.topics, '{pattern}' is several topics for the LiDAR '{name}': {', '.join([topic, *more])}; "
                "expected one."
            )
        if topic in found:
            raise ConfigError(
                f"In ingest.topics, the topic '{topic}' has several names: {found[topic]}, {name}; expected one."
            )
        found[topic] = name
    return found


def _matching(pattern: str, clouds: Mapping[str, Topic], label: str) -> list[str]:
    """Return the topic of that name, else those that match the pattern, else those of that type."""
    if pattern in clouds:
        return [pattern]
    matched = [name for name in clouds if fnmatchcase(name, pattern)]
    typed = [name for name, topic in clouds.items() if topic.count and topic.message_type == normal_type(pattern)]
    if not matched and not typed:
        raise UnknownNameError("point cloud topic", pattern, clouds, label)
    return matched or typed


def _is_twin(topic: Topic, clouds: Mapping[str, Topic]) -> bool:
    """Return whether a topic holds packets of a LiDAR whose point clouds were recorded, too."""
    if not is_packets(topic.message_type):
        return False
    namespace, stem = _namespace_and_stem(topic)
    for other in clouds.values():
        beside, other_stem = _namespace_and_stem(other)
        # In a namespace of its own, a LiDAR needs no name: /sensing/lidar/top/velodyne_packets and .../pointcloud_raw.
        is_same = other_stem == stem or (namespace and not (other_stem and stem))
        if is_same and beside == namespace and other.count and not is_packets(other.message_type):
            return True
    return False


def _namespace_and_stem(topic: Topic) -> tuple[str, str]:
    namespace, _, name = topic.name.rpartition("/")
    return namespace, _COMMON_WORDS.sub("", name.lower())


def _no_clouds(recording: Recording, label: str) -> str:
    clouds = {topic.name for topic in recording.topics if is_cloud(topic)}
    if clouds == {MERGED_TOPIC}:
        return f"{label} holds no point clouds of LiDARs: '{MERGED_TOPIC}' is what `multilica publish` joined."
    silent = sorted(clouds - {MERGED_TOPIC})
    if silent:
        return f"{label} holds no point clouds: its topics {listed(silent)} have no messages."
    unread = unread_notes(recording)
    if unread:
        return f"{label} holds no point clouds that can be read: {unread[0]}"
    types = listed(sorted({topic.message_type for topic in recording.topics})) or "no messages"
    return f"{label} holds no point clouds; expected sensor_msgs/msg/PointCloud2, found {types}."
