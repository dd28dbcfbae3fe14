# SPDX-License-Identifier: Apache-2.0
"""Cost of the driver of `multilica fleet run`: a manifest of many logs whose units take a millisecond."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

from multilica.config import CalibrationConfig
from multilica.fleet.fleet_run import FleetOptions, run_fleet
from multilica.fleet.store.records import LogRow
from multilica.fleet.store.store import open_store
from multilica.fleet.tasks.guard import LogTask, LogTaskLimits, failed_row
from tests.bench.support.claims import at_most, print_claims, print_table

_FEW, _MANY = 10_000, 100_000
_LOGS_PER_VEHICLE = 500
_UNIT_S = 0.001


def main() -> bool:
    """Print memory and time per log, and whether the claims hold."""
    measured = {count: _measure(count) for count in (_FEW, _MANY)}
    print_table(
        ("logs", "driver MB", "ms per log", "ms per log, all finished"),
        [
            (count, f"{each['memory_mb']:.0f}", f"{each['first_ms']:.2f}", f"{each['again_ms']:.2f}")
            for count, each in measured.items()
        ],
    )
    growth = measured[_MANY]["memory_mb"] - measured[_FEW]["memory_mb"]
    return print_claims(
        [
            at_most(f"memory of the driver, {_MANY} logs more than {_FEW}", [growth], 150.0, "MB"),
            at_most("overhead per log beside its unit", [measured[_MANY]["first_ms"] - 1000.0 * _UNIT_S], 20.0, "ms"),
        ]
    )


def _measure(count: int) -> dict[str, float]:
    command = [sys.executable, "-m", __name__, str(count)]
    found: dict[str, float] = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    return found


def _drive(count: int) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as folder:
        manifest = Path(folder, "logs.csv")
        begin = datetime(2026, 1, 1, tzinfo=UTC)
        with manifest.open("w", encoding="utf-8") as file:
            print("source,vehicle,time", file=file)
            for number in range(count):
                vehicle, hour = divmod(number, _LOGS_PER_VEHICLE)
                moment = begin + timedelta(hours=hour)
                print(f"s3://logs/v{vehicle}/{number}.mcap,v{vehicle},{moment.isoformat()}", file=file)
        store = open_store(Path(folder, "store"), create=True)
        options = FleetOptions(CalibrationConfig(), workers=1)
        times_s = []
        for _ in range(2):
            start_s = time.monotonic()
            run_fleet([str(manifest)], store, options, run_log_task=_millisecond)
            times_s.append(time.monotonic() - start_s)
    memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return {
        "memory_mb": memory_mb,
        "first_ms": 1000.0 * times_s[0] / count,
        "again_ms": 1000.0 * times_s[1] / count,
    }


def _millisecond(request: LogTask, limits: LogTaskLimits) -> LogRow:
    del limits
    time.sleep(_UNIT_S)
    row: LogRow = failed_row(request, "stub", "", state="refused")
    open_store(request.store, create=False).finish(row, [])
    return row


if __name__ == "__main__":
    print(json.dumps(_drive(int(sys.argv[1]))))
