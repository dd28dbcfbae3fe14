# SPDX-License-Identifier: Apache-2.0
"""Which topics are taken as LiDARs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase

from multilica.errors import ConfigError, UnfitSnapshotError, UnknownNameError
from multilica.ingest.cloud import is_cloud, obstacle
from multilica.ingest.packets import PACKET_TYPES
from multilica.ingest.recording import Recording, Topic, normal_type

__all__ = ["choose_topics", "unread_notes"]


def choose_topics(
    recording: Recording, asked_for: Mapping[str, str], label: str, only: Sequence[str] = ()
) -> dict[str, str]:
    """Topic -> name of the LiDAR, empty where it is to be named after its frame id.

    A topic may be given by its name, by a pattern as of a shell (``/lidar_*/points``), or by its message type.

    Args:
        asked_for: LiDAR name -> topic, as of `ingest.topics`.
        label: the source, for messages.
        only: topics without names for their LiDARs, as of `ingest.only`; with neither, every point cloud topic that has
            messages is taken.

    Raises:
        UnfitSnapshotError: the recording has no point clouds, or a topic that is named cannot be read.
        UnknownNameError: no such point cloud topic.
        ConfigError: a topic with two names, a name with two topics, or a name that is empty.
    """
    clouds = {topic.name: topic for topic in recording.topics if is_cloud(topic)}
    if not any(topic.count for topic in clouds.values()):
        raise UnfitSnapshotError(_no_clouds(recording, label))
    if not asked_for and not only:
        return {name: topic.lidar for name, topic in clouds.items() if topic.count and not _is_twin(topic, clouds)}
    for topic in recording.topics:
        if topic.name in (*only, *asked_for.values()) and topic.name not in clouds and (held := obstacle(topic)):
            raise UnfitSnapshotError(f"In {label}, '{topic.name}' holds {held}.")
    chosen: dict[str, str] = {}
    for pattern in only:
        chosen |= {name: clouds[name].lidar for name in _matching(pattern, clouds, label)}
    return chosen | _named(asked_for, clouds, label)


def _named(asked_for: Mapping[str, str], clouds: Mapping[str, Topic], label: str) -> dict[str, str]:
    found: dict[str, str] = {}
    for name, pattern in asked_for.items():
        if not name.strip():
            raise ConfigError(f"In ingest.topics, the topic '{pattern}' has an empty name; expected NAME=/topic.")
        topics = _matching(pattern, clouds, label)
        if len(topics) > 1:
            raise ConfigError(
                f"In ingest.topics, '{pattern}' is several topics for the LiDAR '{name}': {', '.join(topics)}; "
                "expected one."
            )
        if topics[0] in found:
            raise ConfigError(
                f"In ingest.topics, the topic '{topics[0]}' has several names: {found[topics[0]]}, {name}; "
                "expected one."
            )
        found[topics[0]] = name
    return found


def _matching(pattern: str, clouds: Mapping[str, Topic], label: str) -> list[str]:
    """The topic of that name, else those that the pattern matches, else those of that type."""
    if pattern in clouds:
        return [pattern]
    matched = [name for name in clouds if fnmatchcase(name, pattern)]
    typed = [name for name, topic in clouds.items() if topic.count and topic.message_type == normal_type(pattern)]
    if not matched and not typed:
        raise UnknownNameError("point cloud topic", pattern, clouds, label)
    return matched or typed


def _is_twin(topic: Topic, clouds: Mapping[str, Topic]) -> bool:
    """Packets of a LiDAR whose driver recorded its point clouds, too."""
    if topic.message_type not in PACKET_TYPES:
        return False
    siblings = [other for other in clouds.values() if other.name.rpartition("/")[0] == topic.name.rpartition("/")[0]]
    return any(other.count and other.message_type not in PACKET_TYPES for other in siblings)


def unread_notes(recording: Recording) -> list[str]:
    """Topics of points that cannot be read here, with what to do about them."""
    clouds = {topic.name: topic for topic in recording.topics if is_cloud(topic)}
    topics: dict[str, list[str]] = defaultdict(list)
    for topic in recording.topics:
        if topic.count and not _is_twin(topic, clouds) and (held := obstacle(topic)):
            topics[held].append(f"'{topic.name}'")
    return [f"{', '.join(names)} {'hold' if len(names) > 1 else 'holds'} {held}." for held, names in topics.items()]


def _no_clouds(recording: Recording, label: str) -> str:
    silent = sorted(topic.name for topic in recording.topics if is_cloud(topic))
    if silent:
        return f"{label} holds no point clouds: its topics {', '.join(silent)} have no messages."
    unread = unread_notes(recording)
    if unread:
        return f"{label} holds no point clouds that can be read: {unread[0]}"
    types = ", ".join(sorted({topic.message_type for topic in recording.topics})) or "no messages"
    return f"{label} holds no point clouds; expected sensor_msgs/msg/PointCloud2, found {types}."
