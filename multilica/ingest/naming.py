# SPDX-License-Identifier: Apache-2.0
"""What the LiDARs of a recording are called."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from multilica.ingest.encodable import encodable

__all__ = ["lidar_names", "shared_frames"]


def lidar_names(given: Mapping[str, str], frame_ids: Mapping[str, str]) -> dict[str, str]:
    """A unique name per topic: the given one, else the frame id, else the topic.

    Args:
        given: topic -> name, empty where none is given.
        frame_ids: topic -> frame id, empty where there is none.
    """
    shared = shared_frames(frame_ids)
    names: dict[str, str] = {}
    taken: set[str] = set()
    for topic in sorted(given, key=lambda topic: (not given[topic], topic)):
        frame_id = "" if frame_ids[topic] in shared else frame_ids[topic]
        names[topic] = _free(encodable(given[topic] or frame_id or topic.strip("/") or topic), taken)
        taken.add(names[topic])
    return names


def shared_frames(frame_ids: Mapping[str, str]) -> dict[str, tuple[str, ...]]:
    """Frame ids that several topics have, with those topics."""
    counts = Counter(frame_id for frame_id in frame_ids.values() if frame_id)
    return {
        frame_id: tuple(sorted(topic for topic, other in frame_ids.items() if other == frame_id))
        for frame_id, count in sorted(counts.items())
        if count > 1
    }


def _free(name: str, taken: set[str]) -> str:
    candidate, number = name, 1
    while candidate in taken:
        number += 1
        candidate = f"{name}_{number}"
    return candidate
