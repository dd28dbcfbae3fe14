# SPDX-License-Identifier: Apache-2.0
"""A fleet whose logs need no calibration: its manifest, tasks that tell what ran, and its tables."""

import threading
import time
from collections import Counter
from dataclasses import replace

from multilica.fleet.fleet_run import FleetOptions, run_fleet
from multilica.fleet.store.query import ask
from multilica.fleet.store.records import MEASURED, LidarRow
from multilica.fleet.store.store import open_store
from multilica.fleet.tasks.guard import failed_row

FLEET = {"v1": 5, "v2": 3, "v3": 4}


class Tasks:
    """Units without calibration: the first log of a vehicle and those with `moved` are calibrated.

    Those with `copy` have the same bytes.
    """

    def __init__(self, *, failing=(), reason="network", stop_after=None, pause_s=0.0):
        self.done, self.running, self.most, self.failing, self.stop_after = [], Counter(), 0, failing, stop_after
        self.reason = reason
        self._lock, self._pause_s = threading.Lock(), pause_s

    def __call__(self, request, _):
        with self._lock:
            if self.stop_after is not None and len(self.done) >= self.stop_after:
                raise KeyboardInterrupt
            self.done.append(request.source)
            self.running[request.vehicle] += 1
            self.most = max(self.most, self.running[request.vehicle])
        time.sleep(self._pause_s * (1 + int(request.key, 16) % 5))
        store = open_store(request.store, create=False)
        row, lidars = failed_row(request, self.reason, "lost"), []
        if request.source not in self.failing:
            calibrated = not request.reference or "moved" in request.source
            own = f"{store.run_folder(request.vehicle, request.time_ns, request.key)}/reference.toml"
            row = replace(
                request.row(),
                state="calibrated" if calibrated else "verified",
                calibration=own if calibrated else request.reference,
                placed=1,
                source_sha256="copy" if "copy" in request.source else request.key,
            )
            if calibrated:
                store.write(own, b"poses")
            lidars = [LidarRow(row.key, row.time_ns, row.source, "left", "top", "verified", "placed", x_m=1.0)]
            if not request.ahead:
                first = store.first_with(row.source_sha256, row.vehicle, row.config_sha256, row.source)
                if first != row.source:
                    row, lidars = replace(request.row(), source_sha256=row.source_sha256).as_duplicate(first), []
                    store.remove(own)
        store.write_lidars(row, lidars)
        if not request.ahead:
            store.write_log(row)
        with self._lock:
            self.running[request.vehicle] -= 1
        return row


def write_manifest(path, fleet=None):
    """The logs of each vehicle, one a day; the third is named `moved`, the sixth and seventh `copy`."""
    kinds = {2: "-moved", 5: "-copy", 6: "-copy"}
    lines = [
        f"s3://logs/{vehicle}/{day}{kinds.get(day, '')}.mcap,{vehicle},2026-0{1 + day // 2}-0{day + 1}T00:00:00Z"
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
