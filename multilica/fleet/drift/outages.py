# SPDX-License-Identifier: Apache-2.0
"""LiDARs that are lost."""

from __future__ import annotations

from itertools import groupby

from multilica.fleet.drift.findings import Outage
from multilica.fleet.store.query import ask
from multilica.fleet.store.store import Store

# One log without a pose is told by `fleet failures`; two in a row are no accident of the scene.
_LEAST_LOGS = 2
_STATES = """
SELECT vehicle, lidar, CASE WHEN status = 'not_placed' THEN reason ELSE '' END AS lost, key, epoch_ns(time) AS time_ns
FROM lidars WHERE time IS NOT NULL ORDER BY vehicle, lidar, time, key
"""


def find_outages(store: Store) -> list[Outage]:
    """Find the LiDARs that have no pose in several logs in a row, in the order of vehicles and LiDARs."""
    outages = []
    with ask(store, _STATES) as answer:
        for (vehicle, lidar), group in groupby(answer.rows(), key=lambda row: row[:2]):
            rows = list(group)
            for reason, spell in groupby(rows, key=lambda row: row[2]):
                logs = list(spell)
                if reason and len(logs) >= _LEAST_LOGS:
                    (*_, key, time_ns), last = logs[0], logs[-1]
                    outages.append(
                        Outage(
                            vehicle=vehicle,
                            lidar=lidar,
                            reason=reason,
                            key=key,
                            time_ns=time_ns,
                            last_time_ns=last[4],
                            logs=len(logs),
                            lasts=last is rows[-1],
                        )
                    )
    return outages
