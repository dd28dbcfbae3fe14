# SPDX-License-Identifier: Apache-2.0
"""Running vehicles as recordings that end at a time limit."""

from multilica.ingest.live.recording import LiveRecording
from multilica.ingest.recording import MessageObserver
from multilica.ingest.remote.address import ROS2, scheme_of
from multilica.ros2 import Ros2Node


def open_live(
    url: str, expected: int, timeout_s: float, observe: MessageObserver, node: Ros2Node | None = None
) -> LiveRecording:
    """Listen at ``ros2://``, ``ws://`` or ``wss://``.

    Args:
        expected, timeout_s, observe: as of `LiveRecording`.
        node: for ``ros2://``, one that stays open.

    Raises:
        UnreadableSourceError: nothing answers there before the time limit.
        MissingDependencyError: the library of that kind of address is not installed.
    """
    if scheme_of(url) == ROS2:
        from multilica.ingest.live.ros2 import Ros2Recording

        return Ros2Recording(expected, timeout_s, observe, node)
    from multilica.ingest.live.foxglove import BridgeRecording

    return BridgeRecording(url, expected, timeout_s, observe)


__all__ = ["LiveRecording", "open_live"]
