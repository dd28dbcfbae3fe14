# SPDX-License-Identifier: Apache-2.0
"""Events of a store as the report shows them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from multilica.fleet.drift.drift import DriftEvent, find_drift
from multilica.fleet.drift.fleet_offsets import FleetOffset, find_offsets
from multilica.fleet.drift.stored_series import Outage, find_outages, read_series
from multilica.fleet.report.contents import PageEvent
from multilica.fleet.report.time_axis import day_of
from multilica.fleet.store.store import Store
from multilica.geometry import FloatArray


def read_events(store: Store) -> list[PageEvent]:
    """Find what `fleet drift` reports without nominal poses: motions, lost LiDARs, vehicles unlike the others."""
    series = list(read_series(store))
    return [
        *map(_motion, find_drift(series)),
        *map(_loss, find_outages(store)),
        *(page_event for offset in find_offsets(series) for page_event in _offset(offset)),
    ]


def _motion(event: DriftEvent) -> PageEvent:
    jumps = event.kind == "jump"
    return PageEvent(
        event.vehicle,
        event.what,
        event.lidars,
        event.kind,
        event.sentence,
        day_of(event.time_ns) if jumps else f"since {day_of(event.last_before_time_ns)}",
        event.last_before_time_ns,
        event.last_time_ns,
        *_lengths(event.translation_m, event.rotation_rad),
    )


def _loss(outage: Outage) -> PageEvent:
    first, last = day_of(outage.time_ns), day_of(outage.last_time_ns)
    return PageEvent(
        outage.vehicle,
        outage.lidar,
        (outage.lidar,),
        "lost",
        outage.sentence,
        f"since {first}" if outage.lasts else f"{first} to {last}",
        outage.time_ns,
        outage.last_time_ns,
    )


def _offset(offset: FleetOffset) -> Iterator[PageEvent]:
    if offset.vehicle is not None:
        translation_mm, rotation_deg = _lengths(offset.translation_m, offset.rotation_rad)
        yield PageEvent(
            offset.vehicle,
            offset.lidar,
            (offset.lidar,),
            "offset",
            offset.sentence,
            translation_mm=translation_mm,
            rotation_deg=rotation_deg,
        )


def _lengths(translation_m: FloatArray, rotation_rad: FloatArray) -> tuple[float, float]:
    """Return the lengths of a translation in mm and of a rotation in degrees."""
    return 1e3 * float(np.linalg.norm(translation_m)), float(np.rad2deg(np.linalg.norm(rotation_rad)))
