# SPDX-License-Identifier: Apache-2.0
"""The frames that are taken of one topic, with what is odd about them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from statistics import median

import numpy as np

from multilica.errors import UnreadableSourceError
from multilica.ingest.cloud import Cloud, decode_cloud, is_cloud
from multilica.ingest.recording import Message
from multilica.snapshot import Scan

__all__ = ["TakenFrames", "clock_notes"]

_MAX_CLOCK_OFFSET_S = 0.5
"""A scan takes a tenth of a second and a log a little more; clocks that differ by more than this were never set."""
_NS_PER_S = 1e9


@dataclass(slots=True)
class TakenFrames:
    """What was taken of one topic so far.

    Args:
        wanted: frames that are asked for; broken ones do not count.
        clouds: in the order of the recording.
        broken: what is wrong with those that cannot be unpacked.
        lost: where the recording is damaged, so that nobody knows how many there were.
        offsets_s: log time minus stamp of each cloud that has both.
        fell_silent: it was given up before it had what was wanted.
    """

    topic: str
    wanted: int
    clouds: list[Cloud] = field(default_factory=list)
    broken: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    offsets_s: list[float] = field(default_factory=list)
    repeated: int = 0
    backward: int = 0
    fell_silent: bool = False

    @property
    def is_full(self) -> bool:
        """There are as many as were asked for."""
        return len(self.clouds) >= self.wanted

    def take(self, message: Message) -> None:
        """Unpack one more, unless there are enough."""
        if self.is_full or not is_cloud(message):
            return
        if message.fault:
            self.lost.append(f"{message.origin} {message.fault}.")
            return
        try:
            cloud = decode_cloud(message)
        except UnreadableSourceError as error:
            self.broken.append(str(error))
            return
        if message.log_time_ns and self._is_repeated(cloud.scan):
            self.repeated += 1
            return
        if message.log_time_ns:
            self.offsets_s.append((message.log_time_ns - cloud.scan.stamp_ns) / _NS_PER_S)
        self.backward += bool(self.clouds) and cloud.scan.stamp_ns < self.clouds[-1].scan.stamp_ns
        self.clouds.append(replace(cloud, scan=_as_logged(cloud.scan, message.log_time_ns)))

    def by_time(self) -> tuple[Cloud, ...]:
        """Oldest first."""
        return tuple(sorted(self.clouds, key=lambda cloud: cloud.scan.stamp_ns))

    def faults(self) -> Iterator[str]:
        """What of the recording cannot be used as it is."""
        taken = len(self.clouds)
        if self.broken:
            scans = f"{len(self.broken)} of {len(self.broken) + taken} scans of '{self.topic}'"
            yield f"{scans} are broken and left out: {self.broken[0]}"
        if self.lost:
            places = "1 place" if len(self.lost) == 1 else f"{len(self.lost)} places"
            yield f"'{self.topic}' has lost scans in {places}: {self.lost[0]}"
        if self.repeated:
            yield f"'{self.topic}' holds {self.repeated} scans twice; each was taken once."
        if self.backward:
            yield f"'{self.topic}' has stamps that go backward; its scans were put in order."
        empty = sum(not len(cloud.scan.points_m) for cloud in self.clouds)
        if empty:
            yield f"'{self.topic}': {empty} of {taken} scans hold no point, or zeros only."
        frame_ids = sorted({cloud.frame_id for cloud in self.clouds})
        if len(frame_ids) > 1:
            yield f"'{self.topic}' has scans in several frames ({', '.join(frame_ids)}), taken as one."

    def remarks(self) -> Iterator[str]:
        """What the messages themselves ask to be told."""
        yield from (f"'{self.topic}' {remark}." for remark in sorted({cloud.remark for cloud in self.clouds} - {""}))

    def _is_repeated(self, scan: Scan) -> bool:
        return any(
            scan.stamp_ns == other.scan.stamp_ns and np.array_equal(scan.points_m, other.scan.points_m)
            for other in self.clouds
        )


def clock_notes(streams: list[TakenFrames]) -> list[str]:
    """Topics whose stamps are far from the log time, or from each other's."""
    offsets_s = {stream.topic: median(stream.offsets_s) for stream in streams if stream.offsets_s}
    if not offsets_s or max(offsets_s.values()) - min(offsets_s.values()) <= _MAX_CLOCK_OFFSET_S:
        return []
    told = ", ".join(f"'{topic}' by {offset_s:.3f} s" for topic, offset_s in sorted(offsets_s.items()))
    return [f"The stamps lag behind the log time: {told}; the frames were chosen by log time."]


def _as_logged(scan: Scan, log_time_ns: int) -> Scan:
    """With the log time, and empty where it only says that no beam came back."""
    if not len(scan.points_m) or scan.points_m.any():
        return replace(scan, log_time_ns=log_time_ns)
    return Scan(np.empty((0, 3), np.float32), scan.stamp_ns, log_time_ns=log_time_ns)
