# SPDX-License-Identifier: Apache-2.0
"""A simulated year of a fleet: every event found and dated, the same tables whatever is killed, and throughput."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from datetime import datetime
from itertools import pairwise
from pathlib import Path

import psutil

from multilica.documents import parse_json
from multilica.fleet.drift.drift import find_drift, find_offsets, find_outages
from multilica.fleet.lidar_series import read_series
from multilica.fleet.store.query import ask
from multilica.fleet.store.records import MEASURED
from multilica.fleet.store.store import Store, open_store
from tests.bench.support.claims import Claim, print_claims

_FEW_VEHICLES = 6
_LEAST_SPEED_UP = 1.8
_KILLS_EVERY_S = (5.0, 15.0)
_DRIVER_S = 30.0


def main() -> bool:
    """Print what was found beside the truth, and whether the claims hold."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        _command("simulate", "--fleet", place / "fleet")
        truth = parse_json((place / "fleet" / "fleet.truth.json").read_bytes())
        whole = _run(place / "fleet", place / "whole")
        chaos = _run_in_chaos(place / "fleet", place / "chaos")
        few = place / "few"
        few.mkdir()
        for vehicle in sorted(truth["vehicles"])[:_FEW_VEHICLES]:
            (few / vehicle).symlink_to(place / "fleet" / vehicle)
        walls_s = []
        for workers in (1, 2):
            start_s = time.monotonic()
            _run(few, place / f"workers{workers}", "--workers", workers)
            walls_s.append(time.monotonic() - start_s)
        same = _tables(whole) == _tables(chaos)
        return print_claims(
            [
                *_events(truth, whole),
                *_failures(truth, whole),
                Claim("tables after kills of workers and driver", "the same", "same" if same else "others", same),
                _speed_up(walls_s),
            ]
        )


def _events(truth: dict, store: Store) -> list[Claim]:
    """Compare what is told with what happened; a log before or after is near enough."""
    series = list(read_series(store))
    told = [(each.vehicle, each.lidars[0], each.kind, each.time_ns) for each in find_drift(series)]
    told += [(each.vehicle, each.lidar, "dead", each.time_ns) for each in find_outages(store)]
    wanted = [(each["vehicle"], each["lidar"], each["kind"], each["first_log_time"]) for each in truth["events"]]
    found = [event for event in wanted if any(_is_told(event, each, truth) for each in told)]
    others = [each for each in told if not any(_is_told(event, each, truth) for event in wanted)]
    others += [(each.vehicle, each.lidar, "offset", 0) for each in find_offsets(series)]
    return [
        Claim("events found and dated to one log", str(len(wanted)), str(len(found)), len(found) == len(wanted)),
        Claim("false alarms", "0", f"{len(others)} {others or ''}", not others),
    ]


def _is_told(event: Sequence[str], told: Sequence[object], truth: dict) -> bool:
    if (*event[:3],) != (*told[:3],):
        return False
    if event[2] == "creep":  # it has no first moment
        return True
    times = sorted({_ns(log["time"]) for log in truth["logs"] if log["vehicle"] == event[0]})
    near = {each for pair in pairwise(times) if _ns(event[3]) in pair for each in pair}
    return any(abs(int(told[3]) - each) < 10**9 for each in near)


def _failures(truth: dict, store: Store) -> list[Claim]:
    broken = {log["path"] for log in truth["logs"] if log["broken"]}
    with ask(store, "SELECT source, state, reason_text FROM logs") as answer:
        rows = {source.partition("/")[2]: (state, text) for source, state, text in answer.rows()}
    listed = {path for path, (state, text) in rows.items() if state == "failed" and path in text}
    copies = {path for path, (state, _) in rows.items() if state == "duplicate"}
    wanted = {log["path"] for log in truth["logs"] if log["duplicate_of"]}
    return [
        Claim("broken files listed with their cause", str(len(broken)), str(len(listed)), listed == broken),
        Claim("copies told as such", str(len(wanted)), str(len(copies)), copies == wanted),
    ]


def _ns(time: str) -> int:
    return round(datetime.fromisoformat(time).timestamp()) * 10**9


def _run(logs: Path, out: Path, *options: object) -> Store:
    _command("fleet", "run", logs, "--out", out, "-q", *options)
    return open_store(out, create=False)


def _command(*arguments: object) -> None:
    command = [sys.executable, "-m", "multilica_cli", *map(str, arguments)]
    subprocess.run(command, check=False, stdout=subprocess.DEVNULL)


def _run_in_chaos(logs: Path, out: Path) -> Store:
    """Kill workers at random, and the driver twice; then let it end, and take up what was killed too often."""
    generator = random.Random(0)  # noqa: S311
    command = [sys.executable, "-m", "multilica_cli", "fleet", "run", str(logs), "--out", str(out), "-q"]
    for attempt in range(3):
        with subprocess.Popen(command) as driver:
            end_s = time.monotonic() + _DRIVER_S
            while driver.poll() is None and (attempt == 2 or time.monotonic() < end_s):
                time.sleep(min(generator.uniform(*_KILLS_EVERY_S), 5.0))
                workers = psutil.Process(driver.pid).children() if driver.poll() is None else []
                if workers:
                    os.kill(generator.choice(workers).pid, signal.SIGKILL)
            driver.kill() if attempt < 2 else driver.wait()
    return _run(logs, out)


def _tables(store: Store) -> list[list[tuple[object, ...]]]:
    found = []
    for name in ("logs", "lidars"):
        with ask(store, f"FROM {name}") as answer:
            kept = [index for index, column in enumerate(answer.columns) if column not in MEASURED]
            found.append(sorted((tuple(row[index] for index in kept) for row in answer.rows()), key=str))
    return found


def _speed_up(walls_s: Sequence[float]) -> Claim:
    factor = walls_s[0] / walls_s[1]
    measured = f"{factor:.2f} x ({walls_s[0]:.1f} and {walls_s[1]:.1f} s)"
    return Claim("throughput of 2 workers against 1", f">= {_LEAST_SPEED_UP} x", measured, factor >= _LEAST_SPEED_UP)
