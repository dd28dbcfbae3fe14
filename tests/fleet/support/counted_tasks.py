# SPDX-License-Identifier: Apache-2.0
"""A fleet whose logs need no calibration: its manifest, tasks that tell what ran, and its tables."""

import threading
from collections import Counter
from dataclasses import replace

from multilica.fleet.fleet_run import FleetOptions, run_fleet
from multilica.fleet.store.query import ask
from multilica.fleet.store.records import MEASURED, LidarRow
from multilica.fleet.store.store import open_store
from multilica.fleet.tasks.guard import failed_row

FLEET = {"v1": 5, "v2": 3, "v3": 4}


class Tasks:
    """Units without calibration: the first log of a vehicle and those with `moved` are calibrated."""

    def __init__(self, *, failing=(), stop_after=None):
        self.done, self.running, self.most, self.failing, self.stop_after = [], Counter(), 0, failing, stop_after
        self._lock = threading.Lock()

    def __call__(self, request, _):
        with self._lock:
            if self.stop_after is not None and len(self.done) >= self.stop_after:
                raise KeyboardInterrupt
            self.done.append(request.source)
            self.running[request.vehicle] += 1
            self.most = max(self.most, self.running[request.vehicle])
        row, lidars = failed_row(request, "network", "lost"), []
        if request.source not in self.failing:
            calibrated = not request.reference or "moved" in request.source
            own = f"runs/{request.key}/reference.toml"
            row = replace(
                request.row(),
                state="calibrated" if calibrated else "verified",
                calibration=own if calibrated else request.reference,
                placed=1,
            )
            lidars = [LidarRow(row.key, row.time_ns, row.source, "left", "top", "verified", "placed", x_m=1.0)]
        open_store(request.store, create=False).finish(row, lidars)
        with self._lock:
            self.running[request.vehicle] -= 1
        return row


def write_manifest(path, fleet=None):
    """The logs of each vehicle, one a day; the third is named `moved`."""
    lines = [
        f"s3://logs/{vehicle}/{day}{'-moved' * (day == 2)}.mcap,{vehicle},2026-0{1 + day // 2}-0{day + 1}T00:00:00Z"
        for vehicle, days in (fleet or FLEET).items()
        for day in range(days)
    ]
    path.write_text("source,vehicle,time\n" + "\n".join(reversed(lines)) + "\n")
    return str(path)


def table(store, name="logs"):
    with ask(store, f"SELECT * FROM {name} ORDER BY vehicle, time, key") as answer:  # noqa: S608
        kept = [index for index, column in enumerate(answer.columns) if column not in MEASURED]
        return [tuple(row[index] for index in kept) for row in answer.rows()]


def run(manifest, store, tasks, **options):
    """Run the fleet; return the outcome and all events."""
    events = []
    return run_fleet([manifest], store, FleetOptions(**options), events.append, tasks), events
