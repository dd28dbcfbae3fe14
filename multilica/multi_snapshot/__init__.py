# SPDX-License-Identifier: Apache-2.0
"""Joint calibration of several snapshots of one rig."""

from multilica.multi_snapshot.join import join, require_joinable
from multilica.multi_snapshot.replay import replay, shown_snapshot
from multilica.multi_snapshot.snapshot_run import SnapshotRun

__all__ = ["SnapshotRun", "join", "replay", "require_joinable", "shown_snapshot"]
