# SPDX-License-Identifier: Apache-2.0
"""Recordings of every format as snapshots."""

from __future__ import annotations

from multilica.ingest.prior import Prior, read_prior
from multilica.ingest.reading import read_snapshot
from multilica.ingest.recorded import frames_recorded
from multilica.ingest.requirement import require_calibratable
from multilica.ingest.snapshots import SnapshotSource, find_snapshots, require_lidar
from multilica.ingest.summary import CloudTopicSummary, OtherTopicSummary, SourceSummary, inspect_source
from multilica.ingest.taking import TakenSnapshot, take_snapshot

__all__ = [
    "CloudTopicSummary",
    "OtherTopicSummary",
    "Prior",
    "SnapshotSource",
    "SourceSummary",
    "TakenSnapshot",
    "find_snapshots",
    "frames_recorded",
    "inspect_source",
    "read_prior",
    "read_snapshot",
    "require_calibratable",
    "require_lidar",
    "take_snapshot",
]
