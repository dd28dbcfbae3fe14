# SPDX-License-Identifier: Apache-2.0
"""Several snapshots of one rig as one result."""

from __future__ import annotations

from multilica.joint.join import join
from multilica.joint.retell import retell, shown_snapshot
from multilica.joint.snapshot_run import SnapshotRun, require_joinable

__all__ = ["SnapshotRun", "join", "require_joinable", "retell", "shown_snapshot"]
