# SPDX-License-Identifier: Apache-2.0
"""The messages of the nodes of a ROS 2 domain."""

import os
import time
from collections import deque
from collections.abc import Callable, Collection, Mapping
from functools import partial

from multilica.errors import UnreadableSourceError
from multilica.ingest.live.recording import LiveRecording
from multilica.ingest.memory import memory_budget
from multilica.ingest.message_types import is_cloud
from multilica.ingest.recording import MessageObserver, RawMessage, Topic, sanitize_text
from multilica.ros2 import Offer, Ros2Node

ADDRESS = "ros2://"
_SETTLED_S = 2.0
"""Nodes are discovered one after the other, most within a second."""
_LOOK_S = 0.2
_MAX_MESSAGE_BYTES = 64 << 20
"""Twenty times the size of a large scan."""


class Ros2Recording(LiveRecording):
    """The messages of a ROS 2 domain, with the quality of service that each publisher offers.

    Args:
        expected, timeout_s, observe: as of `LiveRecording`.
        node: one that stays open; None for a node of its own.

    Raises:
        MissingDependencyError: there is no ROS 2 client for this Python.
        UsageError: it does not start with these environment variables.
    """

    format = "ROS 2"

    def __init__(self, expected: int, timeout_s: float, observe: MessageObserver, node: Ros2Node | None = None) -> None:
        super().__init__(ADDRESS, expected, timeout_s, observe)
        self._offered: dict[str, Topic] = {}
        self._subscribed: dict[str, tuple[Offer, str, Callable[[], None]]] = {}
        self._arrived: deque[tuple[Topic, int, bytes]] = deque()
        self._looked_s = self._changed_s = 0.0
        self._is_own = node is None
        self._node = node or Ros2Node(f"Listening at {ADDRESS}")

    def wait_for(self, is_offered: Callable[[], bool]) -> None:
        """Listen until the nodes offer what is needed and no further LiDAR appears, or time is up."""
        super().wait_for(lambda: is_offered() and time.monotonic() - self._changed_s > _SETTLED_S)
        if not self.topics:
            domain = os.environ.get("ROS_DOMAIN_ID") or "0"
            raise UnreadableSourceError(
                f"No node publishes in the ROS 2 domain {sanitize_text(domain)[:20]} within {self._timeout_s:g} s; "
                "check that the drivers run, and that ROS_DOMAIN_ID and RMW_IMPLEMENTATION are as for them."
            )

    def close(self) -> None:
        """End the subscriptions, and leave the network unless the node was given."""
        for _, _, end in self._subscribed.values():
            end()
        self._subscribed.clear()
        if self._is_own:
            self._node.close()

    def _subscribe(self, names: Collection[str]) -> None:
        for name in sorted(names):
            offer = self._node.offer(name)
            if offer is None or name not in self._offered:
                continue
            topic = self._offered[name]
            known = self._subscribed.get(name)
            if known is not None:
                if known[:2] == (offer, topic.message_type):
                    continue
                known[2]()
            end = self._node.subscribe(name, topic.message_type, offer, partial(self._hear, topic))
            self._subscribed[name] = offer, topic.message_type, end

    def _hear(self, topic: Topic, data: bytes, time_ns: int) -> None:
        self._arrived.append((topic, time_ns, data))

    def _next(self, timeout_s: float) -> RawMessage | None:
        now_s = time.monotonic()
        if now_s - self._looked_s > _LOOK_S:
            self._looked_s = now_s
            self._look()
        self._node.spin(min(timeout_s, _LOOK_S))
        if not self._arrived:
            return None
        topic, log_time_ns, data = self._arrived.popleft()
        if len(data) > _MAX_MESSAGE_BYTES:
            self._count_oddity(f"has more than {_MAX_MESSAGE_BYTES} bytes")
            return None
        return self._received(topic, log_time_ns, memory_budget().keep(data))

    def _look(self) -> None:
        """Find topics that came and went; a publisher that restarts may offer another quality of service."""
        offered = self._node.topics().items()
        found = {name: Topic(name, kind, "cdr") for name, kind in offered if f"{name}{kind}".isprintable()}
        if found != self._offered:
            if _clouds(found) != _clouds(self._offered):
                self._changed_s = time.monotonic()
            self._offered = found
            self._offer(found.values())
        self._subscribe(self._wanted)


def _clouds(topics: Mapping[str, Topic]) -> set[str]:
    return {name for name, topic in topics.items() if is_cloud(topic)}
