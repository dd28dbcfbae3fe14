# SPDX-License-Identifier: Apache-2.0
"""Time limits of a live recording, by a clock that is made up."""

from __future__ import annotations

from collections.abc import Collection
from types import SimpleNamespace

import pytest

from multilica.ingest.live import recording
from multilica.ingest.live.recording import LiveRecording
from multilica.ingest.live.ros2 import Ros2Recording
from multilica.ingest.recording import RawMessage, Topic
from multilica.ros2 import TRANSFORMS, Offer
from tests.ingest.support.recording_writers import CLOUD

STATIC = Topic("/tf_static", TRANSFORMS, "cdr")
POINTS = Topic("/points", CLOUD, "cdr")


class BusyVehicle(LiveRecording):
    """Its subscriptions take two seconds; half a second later come a scan and the static transforms."""

    def __init__(self, now_s: list[float]) -> None:
        super().__init__("made up", 1, 30.0, lambda *_: None)
        self._offer([STATIC, POINTS])
        self.now_s, self.left = now_s, [POINTS, STATIC]

    def _subscribe(self, names: Collection[str]) -> None:
        self.now_s[0] += 2.0 if names else 0.0

    def _next(self, timeout_s: float) -> RawMessage | None:
        self.now_s[0] += min(timeout_s, 0.5)
        return self._received(self.left.pop(0), 0, memoryview(b"")) if self.left else None

    def close(self) -> None:
        """Nothing is open."""


def test_static_transforms_have_time_from_the_subscription(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [0.0]
    monkeypatch.setattr(recording, "time", SimpleNamespace(monotonic=lambda: now_s[0]))
    vehicle = BusyVehicle(now_s)
    assert next(vehicle.messages([POINTS.name])).topic == POINTS.name
    assert [message.topic for message in vehicle.messages([STATIC.name])] == [STATIC.name]
    assert now_s[0] == 3.0


class QueueingNode:
    """A node that hands over messages long after they arrived."""

    def topics(self) -> dict[str, str]:
        return {POINTS.name: POINTS.message_type}

    def offer(self, _: str) -> Offer:
        return Offer(reliable=False, latched=False)

    def subscribe(self, *given: object) -> object:
        self.hear = given[-1]
        return lambda: None

    def spin(self, _: float) -> None:
        self.hear(b"scan", 1234)


def test_the_log_time_of_a_scan_is_its_arrival() -> None:
    vehicle = Ros2Recording(1, 5.0, lambda *_: None, QueueingNode())
    vehicle._look()  # `wait_for` would wait for two seconds
    assert next(vehicle.messages([POINTS.name])).log_time_ns == 1234
