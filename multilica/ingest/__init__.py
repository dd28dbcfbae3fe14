# SPDX-License-Identifier: Apache-2.0
"""Readers of recordings of every format as snapshots."""

from multilica.ingest.drive_reader import read_drive, read_log, stops_of_log
from multilica.ingest.drive_recorder import StopAdvice, take_stops
from multilica.ingest.metadata import frames_recorded
from multilica.ingest.snapshot_reader import (
    TakenSnapshot,
    listen,
    live_address,
    read_snapshot,
    require_calibratable,
    take_snapshot,
)
from multilica.ingest.snapshot_sources import SnapshotSource, find_snapshots, require_lidar
from multilica.ingest.stops import Stop, find_stops, read_stops
from multilica.ingest.summary import SourceSummary, inspect_source
from multilica.ingest.transforms import read_prior

__all__ = [
    "SnapshotSource",
    "SourceSummary",
    "Stop",
    "StopAdvice",
    "TakenSnapshot",
    "find_snapshots",
    "find_stops",
    "frames_recorded",
    "inspect_source",
    "listen",
    "live_address",
    "read_drive",
    "read_log",
    "read_prior",
    "read_snapshot",
    "read_stops",
    "require_calibratable",
    "require_lidar",
    "stops_of_log",
    "take_snapshot",
    "take_stops",
]
