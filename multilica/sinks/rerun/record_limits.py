# SPDX-License-Identifier: Apache-2.0
"""Limits on the size of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

from multilica.config import RecordConfig
from multilica.snapshot import Snapshot


@dataclass(frozen=True, slots=True)
class RecordLimits:
    """Maximum counts in a recording.

    Args:
        raw_points: per LiDAR, before anything is dropped.
        cloud_points: per LiDAR, of the preprocessed cloud, and of the dropped points of each reason.
        feature_points, normals: per LiDAR.
        pair_points: per pair, of each copy of the source's cloud.
        scored_points: per pair and side.
        matches: per pair, of the kept and of the rejected ones, as lines.
        match_rows: per pair, of the matches as data, and of the matches of its surfaces.
    """

    raw_points: int
    cloud_points: int
    feature_points: int
    normals: int
    pair_points: int
    scored_points: int
    matches: int
    match_rows: int

    def thinned(self, share: float) -> RecordLimits:
        """Return the limits multiplied by a share."""
        return RecordLimits(*(int(share * getattr(self, each.name)) for each in fields(self)))


_ALL = 10**9
NO_LIMITS = RecordLimits(*[_ALL] * 8)
_LIMITS: Mapping[str, RecordLimits] = {
    "full": NO_LIMITS,
    "normal": RecordLimits(500_000, 500_000, 500_000, 1500, 30_000, 6000, 1000, 2000),
    "slim": RecordLimits(0, 30_000, 0, 0, 5000, 2000, 200, 200),
}
_POINT_BYTES, _LINE_BYTES, _LABEL_BYTES, _MATCH_BYTES = 12, 24, 2, 80
_CLOUDS_OF_A_PAIR = 4
_SCORED_POSES = 20
_BYTES_OF_A_RUN, _BYTES_OF_A_PAIR = 1_000_000, 500_000
"""Poses, curves, tables, blueprints and the index of the file, whatever the number of points."""
_LEAST_SHARE = 0.01


def limits_for(config: RecordConfig, snapshot: Snapshot) -> tuple[RecordLimits, float]:
    """Return the limits that keep the recording below its budget, and their share of the usual ones."""
    limits = _LIMITS[config.detail]
    if config.detail == "full":
        return limits, 1.0
    counts = [lidar.points_count for lidar in snapshot.lidars]
    pairs = len(counts) * (len(counts) - 1) // 2
    budget = config.max_megabytes * 1e6 - _BYTES_OF_A_RUN - pairs * _BYTES_OF_A_PAIR
    share = min(1.0, max(_LEAST_SHARE, budget / _expected_bytes(limits, counts)))
    return (limits.thinned(share) if share < 1.0 else limits), share


def _expected_bytes(limits: RecordLimits, counts: list[int]) -> float:
    """Return an upper bound of the size: thinning drops more, files are compressed."""
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
        + _MATCH_BYTES * min(limits.match_rows, largest)
        + 2 * (_POINT_BYTES + _SCORED_POSES * _LABEL_BYTES) * min(limits.scored_points, largest)
    )
    return max(1.0, per_lidar + pairs * per_pair)
