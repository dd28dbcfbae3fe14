# SPDX-License-Identifier: Apache-2.0
"""How much of a run goes into its recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

from multilica.config import RecordConfig
from multilica.snapshot import Snapshot

__all__ = ["NO_LIMITS", "RecordLimits", "limits_for"]


@dataclass(frozen=True, slots=True)
class RecordLimits:
    """At most so many of each are recorded.

    Args:
        raw_points: per LiDAR, before anything is dropped.
        cloud_points: per LiDAR, of the preprocessed cloud, and of what was dropped for each reason.
        feature_points, normals: per LiDAR.
        pair_points: per pair, of each copy of the source's cloud.
        judged_points: per pair and side, of the points that the other side's beams judge.
        matches: per pair, of the kept and of the rejected ones.
    """

    raw_points: int
    cloud_points: int
    feature_points: int
    normals: int
    pair_points: int
    judged_points: int
    matches: int

    def thinned(self, share: float) -> RecordLimits:
        """The same, times a share."""
        return RecordLimits(*(int(share * getattr(self, each.name)) for each in fields(self)))


_ALL = 10**9
NO_LIMITS = RecordLimits(_ALL, _ALL, _ALL, _ALL, _ALL, _ALL, _ALL)
_LIMITS: Mapping[str, RecordLimits] = {
    "full": NO_LIMITS,
    "normal": RecordLimits(500_000, 500_000, 500_000, 1500, 30_000, 6000, 1000),
    "slim": RecordLimits(0, 30_000, 0, 0, 5000, 2000, 200),
}
_POINT_BYTES, _LINE_BYTES, _LABEL_BYTES = 12, 24, 2
_CLOUDS_OF_A_PAIR = 4
_JUDGED_POSES = 20
_BYTES_OF_A_RUN, _BYTES_OF_A_PAIR = 1_000_000, 500_000
"""What does not get less with fewer points: poses, curves, tables, layouts, the file's own index."""
_LEAST_SHARE = 0.01


def limits_for(config: RecordConfig, snapshot: Snapshot) -> tuple[RecordLimits, float]:
    """The limits that keep the recording below its budget, with the share of the usual ones that they are."""
    limits = _LIMITS[config.detail]
    if config.detail == "full":
        return limits, 1.0
    counts = [lidar.points_count for lidar in snapshot.lidars]
    pairs = len(counts) * (len(counts) - 1) // 2
    budget = config.max_megabytes * 1e6 - _BYTES_OF_A_RUN - pairs * _BYTES_OF_A_PAIR
    share = min(1.0, max(_LEAST_SHARE, budget / _expected_bytes(limits, counts)))
    return (limits.thinned(share) if share < 1.0 else limits), share


def _expected_bytes(limits: RecordLimits, counts: list[int]) -> float:
    """An upper bound: thinning drops more, files are compressed."""
    per_lidar = sum(
        _POINT_BYTES * (min(limits.raw_points, count) + min(limits.cloud_points, count))
        + _POINT_BYTES * min(limits.feature_points, count)
        + _LINE_BYTES * min(limits.normals, count)
        for count in counts
    )
    pairs, largest = len(counts) * (len(counts) - 1) / 2, max(counts, default=0)
    per_pair = (
        _CLOUDS_OF_A_PAIR * _POINT_BYTES * min(limits.pair_points, largest)
        + 3 * _LINE_BYTES * limits.matches
        + 2 * (_POINT_BYTES + _JUDGED_POSES * _LABEL_BYTES) * min(limits.judged_points, largest)
    )
    return max(1.0, per_lidar + pairs * per_pair)
