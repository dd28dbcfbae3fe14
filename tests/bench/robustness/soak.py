# SPDX-License-Identifier: Apache-2.0
"""Memory, threads and open files of a process that calibrates 200 times, and of one that listens for 10 minutes.

The network of the second one fails every few seconds.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from statistics import median

from multilica.config import CalibrationConfig, with_overrides
from multilica.run import run_calibration
from tests.bench.robustness.crash import ROOT, SAMPLE
from tests.bench.support.claims import Claim, print_claims, print_table
from tests.ingest.support.processes import served

CALIBRATIONS = 200
LISTEN_S = 600.0
PERIOD_S = 5.0
SCAN_EVERY_S = 3.0
MOST_GROWTH = 0.05
_SETTINGS = (
    "ingest.frames=1",
    "runtime.workers=1",
    'ingest.topics={left="/lidar/left/points",right="/lidar/right/points"}',
)
_RESIDENT = re.compile(r"VmRSS:\s+(\d+) kB")
_THREADS = re.compile(r"Threads:\s+(\d+)")


@dataclass(frozen=True, slots=True)
class Use:
    """What a process has at one moment."""

    memory_mb: float
    threads: float
    files: float


def main() -> bool:
    """Print both tables; whether nothing grows."""
    command = [sys.executable, "-m", __name__, str(CALIBRATIONS)]
    ended = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    calibrating = [Use(*values) for values in json.loads(ended.stdout)]
    listening, code, notes = listen(LISTEN_S)
    print(f"The listener ended with {code} and said: {notes}\n")
    claims = [*flat(f"{CALIBRATIONS} calibrations", calibrating), *flat(f"{LISTEN_S:.0f} s of record", listening)]
    return print_claims(claims)


def flat(what: str, uses: Sequence[Use]) -> list[Claim]:
    """The medians of the second and of the last tenth: in the first one, libraries are loaded and pools are filled."""
    tenth = max(1, len(uses) // 10)
    rows, claims = [], []
    for name in Use.__slots__:
        first, last = (median(getattr(use, name) for use in part) for part in (uses[tenth : 2 * tenth], uses[-tenth:]))
        growth = last / first - 1.0
        rows.append((what, name, f"{first:.1f}", f"{last:.1f}", f"{100 * growth:+.1f} %"))
        measure = f"growth of {name} over {what}"
        claims.append(Claim(measure, f"<= {100 * MOST_GROWTH:.0f} %", f"{100 * growth:.1f} %", growth <= MOST_GROWTH))
    print_table(("process", "what", "second tenth", "last tenth", "growth"), rows)
    return claims


def calibrate(count: int) -> list[Use]:
    """Calibrate the same snapshot into the same directory, in this process, with all files; its use after each."""
    config = with_overrides(CalibrationConfig(), _SETTINGS)
    uses = []
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(count):
            run_calibration(SAMPLE, folder, config)
            uses.append(use_of(os.getpid()))
    return uses


def listen(seconds: float) -> tuple[list[Use], int, str]:
    """Record from a vehicle behind a network that fails; its use per second, its exit code, and what it said.

    One LiDAR soon has all its scans, the other one sends few: all that it keeps is small, and it listens to the end.
    """
    uses = []
    with (
        tempfile.TemporaryDirectory() as folder,
        served("bridge_server.py", "cdr", 0, "lidar_1", SCAN_EVERY_S) as vehicle,
        served("faulty_proxy.py", vehicle, PERIOD_S) as network,
    ):
        frames = int(seconds / SCAN_EVERY_S) + 10
        options = ("--frames", frames, "--timeout", seconds, "--out", Path(folder) / "vehicle.mcap")
        command = [sys.executable, "-m", "multilica_cli", "record", f"ws://127.0.0.1:{network}", *map(str, options)]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(ROOT), str(ROOT / "cli")))}
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=environment) as process:
            start_s = time.monotonic()
            while process.poll() is None and time.monotonic() - start_s < seconds - 1.0:
                uses.append(use_of(process.pid))
                time.sleep(1.0)
            told = process.communicate()[0].decode()
    return uses, process.returncode, " ".join(told.split())


def use_of(process: int) -> Use:
    """The use of a process that runs."""
    folder = Path("/proc") / str(process)
    status = (folder / "status").read_text(encoding="ascii")
    memory_kb, threads = (float(pattern.findall(status)[0]) for pattern in (_RESIDENT, _THREADS))
    return Use(memory_kb / 1e3, threads, float(len(list((folder / "fd").iterdir()))))


if __name__ == "__main__":
    print(json.dumps([astuple(use) for use in calibrate(int(sys.argv[1]))]))
