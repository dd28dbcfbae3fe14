# SPDX-License-Identifier: Apache-2.0
"""Messages that are point clouds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import cast

from multilica.errors import UnreadableSourceError
from multilica.ingest.recording import Message, Topic
from multilica.snapshot import Scan

__all__ = ["Cloud", "decode_cloud", "is_cloud"]

_DECODERS = {
    ("sensor_msgs/msg/PointCloud2", "cdr"): "multilica.ingest.ros_messages",
    ("sensor_msgs/msg/PointCloud2", "ros1"): "multilica.ingest.ros_messages",
    ("PCD", "pcd"): "multilica.ingest.pcd",
    ("PLY", "ply"): "multilica.ingest.ply",
}
"""(message type, encoding) -> module whose `decode_cloud` unpacks it."""


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """One unpacked frame.

    Args:
        frame_id: as the message says, without slashes at its ends; empty where the format has none.
    """

    scan: Scan
    frame_id: str = ""


def is_cloud(of: Topic | Message) -> bool:
    """Whether this message, or those on this topic, can be unpacked to points."""
    return (of.message_type, of.encoding) in _DECODERS


def decode_cloud(message: Message) -> Cloud:
    """Unpack a message of a topic for which `is_cloud` holds.

    Raises:
        UnreadableSourceError: the message is broken.
    """
    module = import_module(_DECODERS[message.message_type, message.encoding])
    decode = cast(Callable[[Message], Cloud], module.decode_cloud)
    try:
        return decode(message)
    except ValueError as error:
        raise UnreadableSourceError(f"{message.origin} {error}.") from error
