# SPDX-License-Identifier: Apache-2.0
"""Report of a store."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from multilica.fleet.report.contents import FleetOverview, PageFailure, PageVehicle
from multilica.fleet.report.events import read_events
from multilica.fleet.report.histories import read_histories
from multilica.fleet.report.page import drawn_vehicles, fleet_page
from multilica.fleet.store import query
from multilica.fleet.store.store import Store


def store_report(store: Store, page: Path) -> str:
    """Render the report of a store.

    Args:
        page: where it will lie; files of the store are linked if that is within the store.
    """
    from multilica import __version__

    vehicles, events, failures = _vehicles(store), read_events(store), _failures(store)
    drawn = drawn_vehicles([vehicle.name for vehicle in vehicles], events, failures)
    histories = read_histories(store, drawn)
    overview = FleetOverview(store.name, __version__, _files_seen_from(page, store))
    shown = [replace(vehicle, histories=histories.get(vehicle.name, ())) for vehicle in vehicles]
    return fleet_page(overview, shown, events, failures)


def _vehicles(store: Store) -> list[PageVehicle]:
    with query.status(store) as answer:
        rows = [dict(zip(answer.columns, row, strict=True)) for row in answer.rows()]
    return [
        PageVehicle(
            row["vehicle"],
            row["logs"],
            row["first"],
            row["last"],
            row["verified"],
            row["calibrated"],
            row["without_result"],
            row["duplicates"],
            tuple((row["not_placed_last"] or "").split(", ")) if row["not_placed_last"] else (),
        )
        for row in rows
    ]


def _failures(store: Store) -> list[PageFailure]:
    def kept(path: str) -> bool:  # `fleet prune` removes recordings; a request for each were slow in a bucket
        return store.system is not None or store.exists(path)

    with query.failures(store) as answer:
        return [
            PageFailure(vehicle, time, source, lidar, outcome, reason, sentence, recording if kept(recording) else "")
            for vehicle, time, source, lidar, outcome, reason, sentence, recording in answer.rows()
        ]


def _files_seen_from(page: Path, store: Store) -> str | None:
    """Return the relative path from the page's folder to the store; None if the page lies elsewhere."""
    if store.system is not None:
        return None
    root, folder = Path(store.root).resolve(), page.absolute().parent.resolve()
    if not folder.is_relative_to(root):
        return None
    path = os.path.relpath(root, folder)
    return "" if path == "." else path
