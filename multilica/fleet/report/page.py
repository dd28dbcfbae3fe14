# SPDX-License-Identifier: Apache-2.0
"""HTML page of a store: findings, vehicles, failures and poses over time."""

from __future__ import annotations

import os
import re
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import Any
from urllib.parse import quote

from jinja2 import Template
from markupsafe import Markup

import multilica
from multilica.errors import escape_controls
from multilica.extrinsics import Extrinsics
from multilica.fleet.drift.drift import find_drift, find_offsets, find_outages
from multilica.fleet.drift.findings import DriftEvent, Finding
from multilica.fleet.lidar_series import LidarSeries, read_series
from multilica.fleet.report import charts
from multilica.fleet.report.charts import drift_plots, sparklines
from multilica.fleet.store.query import FAILURES, STATUS, ask
from multilica.fleet.store.store import Store
from multilica.sinks.report.template import own_text, page_template

MAX_BYTES = 8_000_000
"""Limit of ticket systems and mail; texts of single logs are left out first, then plots."""
MAX_DRAWN = 200
"""A larger fleet has plots only of vehicles with an event or a failure, and of at most this many."""
MAX_EVENTS = MAX_FAILURES = 1000
"""Rows of a table; more are not read by people, and the commands list all."""

_PACKAGE = "multilica.fleet.report"
_FRAME = {"width": charts.WIDTH_PX, "left": charts.LEFT_PX, "right": charts.RIGHT_PX, "strip": charts.STRIP_PX}
_DATE = re.compile(r"(\b\d{4}-\d\d-\d\d(?: \d\d:\d\d)?\b)", re.ASCII)


@dataclass(frozen=True, slots=True)
class PageVehicle:
    """A row of the overview, and the section of a vehicle.

    Args:
        not_placed_last: LiDARs without a certain pose in the last log with a result, with reasons.
        histories: of its LiDARs except the target; empty if they are not to be drawn.
    """

    name: str
    logs: int
    first: datetime | None
    last: datetime | None
    verified: int
    calibrated: int
    without_result: int
    duplicates: int
    not_placed_last: tuple[str, ...] = ()
    histories: tuple[LidarSeries, ...] = ()


@dataclass(frozen=True, slots=True)
class PageFailure:
    """A log without a result, or a LiDAR without a certain pose in a log.

    Args:
        lidar: empty if it is the whole log.
        recording: path in the store; empty if there is none.
    """

    vehicle: str
    time: datetime | None
    source: str
    lidar: str
    outcome: str
    reason: str
    sentence: str
    recording: str = ""


def store_report(store: Store, page: Path, nominal: Extrinsics | None = None) -> str:
    """Render the report of a store, with the findings of `fleet drift`.

    Args:
        page: where it will lie; files of the store are linked if that is within the store.
        nominal: poses as designed.
    """
    series, failures = list(read_series(store)), _failures(store)
    events: list[Finding] = [*find_drift(series), *find_outages(store), *find_offsets(series, nominal)]
    with ask(store, STATUS) as answer:
        rows = list(answer.rows())
    drawn = drawn_vehicles([vehicle for vehicle, *_ in rows], events, failures)
    histories = {
        vehicle: tuple(own) for vehicle, own in groupby(series, key=lambda each: each.vehicle) if vehicle in drawn
    }
    vehicles = [
        PageVehicle(*(*row, tuple(lacking.split(", ")) if lacking else (), histories.get(row[0], ())))
        for *row, lacking in rows
    ]
    return fleet_page(store.name, vehicles, events, failures, _files_seen_from(page, store))


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
    return os.path.relpath(root, folder) if folder.is_relative_to(root) else None


def drawn_vehicles(names: Sequence[str], events: Sequence[Finding], failures: Sequence[PageFailure]) -> list[str]:
    """Return the vehicles to draw, first those with events, then those with failures; of a large fleet, only these."""
    first = dict.fromkeys([*(event.vehicle for event in events), *(failure.vehicle for failure in failures)])
    known = set(names)
    urgent = [name for name in first if name in known]
    others = [name for name in names if name not in first] if len(names) <= MAX_DRAWN else []
    return [*urgent, *others][:MAX_DRAWN]


def fleet_page(
    store: str,
    vehicles: Sequence[PageVehicle],
    events: Sequence[Finding],
    failures: Sequence[PageFailure],
    files: str | None = None,
) -> str:
    """Render the report as one self-contained page.

    Args:
        store: its name.
        vehicles: all of the fleet; the histories only of those to draw (`drawn_vehicles`).
        events: of LiDARs, in the order of the table.
        failures: of logs and LiDARs.
        files: relative path of the store as seen from the page; None if no file of the store can be linked.

    Returns:
        A page of at most `MAX_BYTES` bytes unless its tables alone are larger.
    """
    context = {"store": store, "files": files, **_context(vehicles, events, failures)}
    names = drawn_vehicles([each.name for each in vehicles if each.histories], events, failures)
    page = ""
    for count, texts in ((len(names), True), *((len(names) >> halvings, False) for halvings in range(8)), (0, False)):
        shown = [vehicle for vehicle in vehicles if vehicle.name in names[:count]]
        own = context["own_events"]
        plots = {each.name: _plots(each, own.get(each.name, ()), texts=texts) for each in shown}
        page = _template().render(context, shown=shown, plots=plots)
        if len(page.encode()) <= MAX_BYTES:
            break
    return page


def _context(
    vehicles: Sequence[PageVehicle], events: Sequence[Finding], failures: Sequence[PageFailure]
) -> dict[str, Any]:
    """Return what the template shows of the fleet, except the sections of the vehicles."""
    own_events: dict[str, list[Finding]] = defaultdict(list)
    for event in events:
        own_events[event.vehicle or ""].append(event)
    moved = {(event.vehicle, event.part) for event in events if isinstance(event, DriftEvent)}
    causes = _causes(failures)
    rank = {reason: index for index, (reason, *_) in enumerate(causes)}
    times = [time for vehicle in vehicles for time in (vehicle.first, vehicle.last) if time is not None]
    histories = {vehicle.name: vehicle.histories for vehicle in vehicles}
    return {
        "version": multilica.__version__,
        "vehicles": vehicles,
        "events": events,
        "shown_events": events[:MAX_EVENTS],
        "own_events": own_events,
        "moved": moved,
        "moved_on": len({vehicle for vehicle, _ in moved}),
        "failures": sorted(failures, key=lambda failure: rank[failure.reason])[:MAX_FAILURES],
        "failure_count": len(failures),
        "causes": causes,
        "first": min(times, default=None),
        "last": max(times, default=None),
        "anchors": {vehicle.name: f"vehicle-{index}" for index, vehicle in enumerate(vehicles, 1)},
        "lines": {"mm": sparklines(histories, slice(3)), "deg": sparklines(histories, slice(3, 6))},
        "line_size": (charts.LINE_WIDTH_PX, charts.LINE_HEIGHT_PX),
        "frame": _FRAME,
        "max_drawn": MAX_DRAWN,
    }


def _plots(vehicle: PageVehicle, events: Sequence[Finding], *, texts: bool) -> list[tuple[LidarSeries, Any]]:
    """Return the series of a vehicle with their plots, those with an event first."""
    own = [(series, [event for event in events if series.lidar in _lidars(event)]) for series in vehicle.histories]
    own.sort(key=lambda each: not each[1])
    return [(series, drift_plots(series, found, texts=texts)) for series, found in own]


def _lidars(event: Finding) -> tuple[str, ...]:
    return event.lidars if isinstance(event, DriftEvent) else (event.lidar,)


def _causes(failures: Sequence[PageFailure]) -> list[tuple[str, int, int]]:
    """Return the causes, the most frequent first: logs without a result, and LiDARs without a certain pose."""
    logs = Counter(failure.reason for failure in failures if not failure.lidar)
    both = Counter(failure.reason for failure in failures)
    return [(name, logs[name], both[name] - logs[name]) for name in sorted(both, key=lambda name: (-both[name], name))]


@cache
def _template() -> Template:
    style = own_text("multilica.sinks.report", "page.css") + own_text(_PACKAGE, "page.css")
    filters = {
        "day": lambda time: "-" if time is None else f"{time:%Y-%m-%d}",
        "counted": lambda count, noun: f"{count:,} {noun}{'' if count == 1 else 's'}",
        "px": charts.number,
        # Relative, and names in the store may hold percent signs.
        "address": lambda path, files: quote(f"{files}/{path}"),
        "with_dates": _with_dates,
    }
    return page_template(_PACKAGE, style, own_text(_PACKAGE, "page.js"), filters, one_line=True)


def _with_dates(text: str) -> Markup:
    """Keep each date of a text in one line."""
    parts = _DATE.split(escape_controls(text))
    date = Markup('<span class="when">{}</span>')
    return Markup("").join(date.format(part) if index % 2 else part for index, part in enumerate(parts))
