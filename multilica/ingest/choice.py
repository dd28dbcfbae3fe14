# SPDX-License-Identifier: Apache-2.0
"""Which topics are taken as LiDARs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from multilica.errors import ConfigError, UnfitSnapshotError, UnknownNameError
from multilica.ingest.cloud import is_cloud
from multilica.ingest.recording import Recording

__all__ = ["choose_topics"]


def choose_topics(recording: Recording, asked_for: Mapping[str, str], label: str) -> dict[str, str]:
    """Topic -> name of the LiDAR, empty where it is to be named after its frame id.

    Args:
        asked_for: LiDAR name -> topic, as of `ingest.topics`; empty: every point cloud topic that has messages.
        label: the source, for messages.

    Raises:
        UnfitSnapshotError: the recording has no point clouds.
        UnknownNameError: no point cloud topic of that name.
        ConfigError: a topic with two names, or a name that is empty.
    """
    clouds = {topic.name: topic for topic in recording.topics if is_cloud(topic)}
    if not any(topic.count for topic in clouds.values()):
        raise UnfitSnapshotError(_no_clouds(recording, label))
    if not asked_for:
        return {name: topic.lidar for name, topic in clouds.items() if topic.count}
    for name, topic in asked_for.items():
        if topic not in clouds:
            raise UnknownNameError("point cloud topic", topic, clouds, label)
        if not name.strip():
            raise ConfigError(f"In ingest.topics, the topic '{topic}' has an empty name; expected NAME=/topic.")
    twice = [topic for topic, count in Counter(asked_for.values()).items() if count > 1]
    if twice:
        names = ", ".join(name for name, topic in asked_for.items() if topic == twice[0])
        raise ConfigError(f"In ingest.topics, the topic '{twice[0]}' has several names: {names}; expected one.")
    return {topic: name for name, topic in asked_for.items()}


def _no_clouds(recording: Recording, label: str) -> str:
    silent = sorted(topic.name for topic in recording.topics if is_cloud(topic))
    if silent:
        return f"{label} holds no point clouds: its topics {', '.join(silent)} have no messages."
    types = ", ".join(sorted({topic.message_type for topic in recording.topics})) or "no messages"
    return f"{label} holds no point clouds; expected sensor_msgs/msg/PointCloud2, found {types}."
