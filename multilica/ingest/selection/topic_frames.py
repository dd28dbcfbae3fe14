# SPDX-License-Identifier: Apache-2.0
"""The frames of one topic."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from statistics import median

import numpy as np

from multilica.errors import UnreadableSourceError
from multilica.ingest.memory import memory_budget
from multilica.ingest.messages.cloud import Cloud, decode_cloud, is_cloud
from multilica.ingest.recording import RawMessage
from multilica.snapshot import Scan

_MAX_CLOCK_OFFSET_S = 0.5
"""A scan takes a tenth of a second and logging a little more; a larger difference means that clocks are not set."""
_MAX_BROKEN = 1000
_NS_PER_S = 1e9


@dataclass(slots=True)
class TopicFrames:
    """The frames of one topic so far.

    Args:
        wanted: number of frames; broken ones do not count.
        clouds: in the order of the recording.
        broken: errors of the scans that cannot be decoded.
        lost: errors of damaged parts of the recording, with an unknown number of scans.
        offsets_s: log time minus stamp of each cloud that has both.
        repeated: scans that are equal to one before.
        backward: scans with a stamp before that of the previous one.
        fell_silent: whether the topic was given up before it was full.
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
        """Whether there are enough frames, or so many broken ones that no more are tried."""
        return len(self.clouds) >= self.wanted or len(self.broken) >= _MAX_BROKEN

    def take(self, message: RawMessage) -> None:
        """Decode and add a scan, unless there are enough."""
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
        scan = cloud.scan
        if message.log_time_ns:
            if any(
                scan.stamp_ns == other.scan.stamp_ns and np.array_equal(scan.points_m, other.scan.points_m)
                for other in self.clouds
            ):
                self.repeated += 1
                return
            self.offsets_s.append((message.log_time_ns - scan.stamp_ns) / _NS_PER_S)
        self.backward += bool(self.clouds) and scan.stamp_ns < self.clouds[-1].scan.stamp_ns
        if len(scan.points_m) and not scan.points_m.any():
            # Zeros mean that no beam returned.
            scan = Scan(np.empty((0, 3), np.float32), scan.stamp_ns)
        memory_budget().take(scan.points_m.nbytes + (0 if scan.intensity is None else scan.intensity.nbytes))
        self.clouds.append(replace(cloud, scan=replace(scan, log_time_ns=message.log_time_ns)))

    def by_time(self) -> tuple[Cloud, ...]:
        """Return the clouds by stamp, oldest first."""
        return tuple(sorted(self.clouds, key=lambda cloud: cloud.scan.stamp_ns))

    def faults(self) -> Iterator[str]:
        """Yield sentences on scans that cannot be used as they are."""
        taken = len(self.clouds)
        if self.broken:
            scans = f"{len(self.broken)} of {len(self.broken) + taken} scans of '{self.topic}'"
            yield f"{scans} are broken and left out: {self.broken[0]}"
        if self.lost:
            places = "1 place" if len(self.lost) == 1 else f"{len(self.lost)} places"
            yield f"'{self.topic}' has lost scans in {places}: {self.lost[0]}"
        if self.repeated:
            yield f"'{self.topic}' holds {self.repeated} scans twice; each was used once."
        if self.backward:
            yield f"'{self.topic}' has stamps that go backward; its scans were sorted."
        empty = sum(not len(cloud.scan.points_m) for cloud in self.clouds)
        if empty:
            yield f"'{self.topic}': {empty} of {taken} scans have no points, or only zeros."
        frame_ids = sorted({cloud.frame_id for cloud in self.clouds})
        if len(frame_ids) > 1:
            yield f"'{self.topic}' has scans in several frames ({', '.join(frame_ids)}), used as one."

    def remarks(self) -> Iterator[str]:
        """Yield the remarks of the decoders."""
        yield from (f"'{self.topic}' {remark}." for remark in sorted({cloud.remark for cloud in self.clouds} - {""}))


def clock_notes(streams: list[TopicFrames]) -> list[str]:
    """Return a note if the offsets between stamps and log times differ between topics."""
    offsets_s = {stream.topic: median(stream.offsets_s) for stream in streams if stream.offsets_s}
    if not offsets_s or max(offsets_s.values()) - min(offsets_s.values()) <= _MAX_CLOCK_OFFSET_S:
        return []
    listed = ", ".join(f"'{topic}' by {offset_s:.3f} s" for topic, offset_s in sorted(offsets_s.items()))
    return [f"The stamps lag behind the log time: {listed}; the frames were chosen by log time."]
