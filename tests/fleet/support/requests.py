# SPDX-License-Identifier: Apache-2.0
"""Logs and requests of tasks."""

import hashlib

from multilica.checks import RigTolerances
from multilica.config import CalibrationConfig
from multilica.fleet.listing import FleetLog
from multilica.fleet.store.store import open_store
from multilica.fleet.tasks.guard import LogTask

DAY_NS = 86_400 * 10**9
START_NS = 1_767_225_600 * 10**9  # 2026-01-01


def log(source, *, vehicle="v1", day=0, folder="/logs"):
    time_ns = None if day is None else START_NS + day * DAY_NS
    return FleetLog(f"{folder}/{source}", source, 10, hashlib.sha256(source.encode()).hexdigest()[:8], vehicle, time_ns)


def request(folder, source, **changes):
    store = folder / "store"
    open_store(store, create=True)
    values = {
        "key": hashlib.sha256(source.encode()).hexdigest()[:32],
        "address": str(folder / source),
        "source": source,
        "fingerprint": "f",
        "size_bytes": 1,
        "vehicle": "v1",
        "time_ns": START_NS,
        "store": str(store),
        "config": CalibrationConfig(),
        "config_sha256": "c",
        "tolerances": RigTolerances(),
        "calibrate": "when-needed",
        "reference": "",
    }
    return LogTask(**(values | changes))
