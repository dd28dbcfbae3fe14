# SPDX-License-Identifier: Apache-2.0
"""Report of a store."""

from __future__ import annotations

import os
from dataclasses import replace
from itertools import groupby
from pathlib import Path

from multilica.fleet.drift.drift import find_drift
from multilica.fleet.drift.findings import Finding
from multilica.fleet.drift.fleet_offsets import find_offsets
from multilica.fleet.drift.outages import find_outages
from multilica.fleet.lidar_series import read_series
from multilica.fleet.report.charts import LidarHistory
from multilica.fleet.report.page import FleetOverview, PageFailure, PageVehicle, drawn_vehicles, fleet_page
from multilica.fleet.store.query import FAILURES, STATUS, ask
from multilica.fleet.store.store import Store


def store_report(store: Store, page: Path) -> str:
    """Render the report of a store, with the findings of `fleet drift` without nominal poses.

    Args:
        page: where it will lie; files of the store are linked if that is within the store.
    """
    from multilica import __version__

    series, failures = list(read_series(store)), _failures(store)
    unlike = [offset for offset in find_offsets(series) if offset.vehicle is not None]
    events: list[Finding] = [*find_drift(series), *find_outages(store), *unlike]
    with ask(store, STATUS) as answer:
        rows = list(answer.rows())
    drawn = drawn_vehicles([vehicle for vehicle, *_ in rows], events, failures)
    histories = {
        vehicle: tuple(map(LidarHistory.of, own))
        for vehicle, own in groupby(series, key=lambda each: each.vehicle)
        if vehicle in drawn
    }
    vehicles = [
        replace(
            PageVehicle(*row[:-1]),
            not_placed_last=tuple(row[-1].split(", ")) if row[-1] else (),
            histories=histories.get(row[0], ()),
        )
        for row in rows
    ]
    return fleet_page(FleetOverview(store.name, __version__, _files_seen_from(page, store)), vehicles, events, failures)


def _failures(store: Store) -> list[PageFailure]:
    def kept(path: str) -> bool:  # `fleet prune` removes recordings; a request for each were slow in a bucket
        return store.system is not None or store.exists(path)

    with ask(store, FAILURES) as answer:
        failures = [PageFailure(*row) for row in answer.rows()]
    return [each if kept(each.recording) else replace(each, recording="") for each in failures]


def _files_seen_from(page: Path, store: Store) -> str | None:
    """Return the relative path from the page's folder to the store; None if the page lies elsewhere."""
    if store.system is not None:
        return None
    root, folder = Path(store.root).resolve(), page.absolute().parent.resolve()
    if not folder.is_relative_to(root):
        return None
    path = os.path.relpath(root, folder)
    return "" if path == "." else path
