# SPDX-License-Identifier: Apache-2.0
"""LiDARs that are lost."""

from __future__ import annotations

from multilica.fleet.drift.findings import Outage
from multilica.fleet.store.query import ask
from multilica.fleet.store.store import Store

# One log without a pose is told by `fleet failures`; two in a row are no accident of the scene.
_OUTAGES = """
WITH states AS (
  SELECT vehicle, lidar, CASE WHEN status = 'not_placed' THEN reason ELSE '' END AS lost, key,
         epoch_ns(time) AS time_ns, row_number() OVER (PARTITION BY vehicle, lidar ORDER BY time, key) AS place,
         count(*) OVER (PARTITION BY vehicle, lidar) AS total
  FROM lidars WHERE time IS NOT NULL),
spells AS (
  SELECT *, place - row_number() OVER (PARTITION BY vehicle, lidar, lost ORDER BY place) AS spell FROM states)
SELECT vehicle, lidar, lost AS reason, arg_min(key, place) AS key, min(time_ns) AS time_ns,
       max(time_ns) AS last_time_ns, count(*) AS logs, max(place) = any_value(total) AS lasts
FROM spells WHERE lost <> '' GROUP BY vehicle, lidar, lost, spell HAVING count(*) >= 2
ORDER BY vehicle, lidar, min(place)
"""


def find_outages(store: Store) -> list[Outage]:
    """Find the LiDARs that have no pose in several logs in a row, in the order of vehicles and LiDARs."""
    with ask(store, _OUTAGES) as answer:
        return [Outage(**dict(zip(answer.columns, row, strict=True))) for row in answer.rows()]
