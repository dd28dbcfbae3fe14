# SPDX-License-Identifier: Apache-2.0
"""Messages that are point clouds."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from typing import cast

from multilica.errors import UnreadableSourceError
from multilica.ingest.damage import reason_of
from multilica.ingest.memory import require_decodable
from multilica.ingest.message_types import MESSAGE_TYPES, OTHER_PACKETS, is_installed
from multilica.ingest.recording import RawMessage, Topic
from multilica.snapshot import Scan

_MAX_NAME = 32
_MAX_STAMP_NS = 1 << 64
"""Stamps beyond are no times, and overflow."""


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """One decoded frame.

    Args:
        frame_id: without slashes at its ends; empty if the format has none.
        remark: what the user should know about the topic, as a predicate; empty for nothing.
    """

    scan: Scan
    frame_id: str = ""
    remark: str = ""


def is_cloud(of: Topic | RawMessage) -> bool:
    """Return whether a message, or those on a topic, can be decoded to points."""
    known = MESSAGE_TYPES.get(of.message_type)
    return known is not None and of.encoding in known.encodings and is_installed(known.requires)


def obstacle(topic: Topic) -> str:
    """Return why a topic with points cannot be decoded and what to do about it; empty for every other topic."""
    known = MESSAGE_TYPES.get(topic.message_type)
    if known is None or is_cloud(topic) or topic.encoding == OTHER_PACKETS:
        return ""
    if known.packets:
        return known.incomplete if known.requires and is_installed(known.requires) else known.packets
    expected = " or ".join(known.encodings)
    return f"{topic.message_type} in the encoding {topic.encoding[:_MAX_NAME]!r}; expected {expected}"


def decode_cloud(message: RawMessage) -> Cloud:
    """Decode a message for which `is_cloud` is true; raise UnreadableSourceError if it is broken."""
    if message.fault:
        raise UnreadableSourceError(f"{message.origin} {message.fault}.")
    try:
        require_decodable(len(message.data))
        cloud = _decoder(MESSAGE_TYPES[message.message_type].decoder)(message)
    except ValueError as error:
        raise UnreadableSourceError(f"{message.origin} {error}.") from error
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError) as error:
        raise UnreadableSourceError(f"{message.origin} cannot be decoded: {reason_of(error)}.") from error
    if abs(cloud.scan.stamp_ns) >= _MAX_STAMP_NS:
        return replace(cloud, scan=replace(cloud.scan, stamp_ns=message.log_time_ns))
    return cloud


@cache
def _decoder(module: str) -> Callable[[RawMessage], Cloud]:
    return cast(Callable[[RawMessage], Cloud], import_module(f"multilica.ingest.{module}").decode_cloud)
