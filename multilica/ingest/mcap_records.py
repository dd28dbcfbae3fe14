# SPDX-License-Identifier: Apache-2.0
"""MCAP's records in the terms of `recording`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TypeAlias

from mcap.records import Channel, Schema
from mcap.records import Message as McapMessage

from multilica.ingest.recording import Message, Topic, normal_type
from multilica.pointcloud2 import LIDAR_NAME_KEY

__all__ = ["Record", "message_of", "topics_of"]

Record: TypeAlias = tuple[Schema | None, Channel, McapMessage]


def topics_of(
    channels: Iterable[Channel], schemas: Mapping[int, Schema], counts: Mapping[int, int]
) -> tuple[Topic, ...]:
    """Topics by name; `counts` holds the messages per channel id."""
    totals: Counter[tuple[str, str, str, str]] = Counter()
    for channel in channels:
        lidar = channel.metadata.get(LIDAR_NAME_KEY, "")
        key = (channel.topic, _type_name(schemas.get(channel.schema_id)), channel.message_encoding, lidar)
        totals[key] += counts.get(channel.id, 0)
    return tuple(
        Topic(name, message_type, encoding, count, lidar)
        for (name, message_type, encoding, lidar), count in sorted(totals.items())
    )


def message_of(record: Record, path: Path) -> Message:
    """The message, its bytes untouched."""
    schema, channel, message = record
    origin = f"In {path}, a scan of '{channel.topic}'"
    return Message(channel.topic, _type_name(schema), channel.message_encoding, message.log_time, message.data, origin)


def _type_name(schema: Schema | None) -> str:
    return "without schema" if schema is None else normal_type(schema.name)
