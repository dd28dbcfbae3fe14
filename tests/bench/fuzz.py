# SPDX-License-Identifier: Apache-2.0
"""Thousands of damaged files for each reader: points or one sentence, no hang, no memory without bounds."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from tests.ingest.support.mutations import SEEDS, mutated, read_or_refuse, write_seed

MUTATIONS = int(os.environ.get("MULTILICA_MUTATIONS", "20000"))
MEMORY_BYTES = 1 << 30
"""On top of what the imports take."""


def main() -> bool:
    """Print a line per reader, and whether all held; each runs in a process of its own, so that a crash is seen."""
    print(f"{MUTATIONS} mutations per reader, at most {MEMORY_BYTES >> 20} MiB more than at the start\n")
    print("| reader | read | refused | slowest s | peak MiB more | outcome |")
    print("|---|---|---|---|---|---|")
    good = True
    for name in SEEDS:
        command = [sys.executable, "-m", "tests.bench.fuzz", name, str(MUTATIONS)]
        ended = subprocess.run(command, capture_output=True, text=True, check=False)
        died = f"| {name} | | | | | died with {ended.returncode}: {ended.stderr.strip()[-200:]} |"
        row = ended.stdout.strip() or died
        good &= row.endswith("| good |")
        print(row, flush=True)
    return good


def fuzz(name: str, mutations: int) -> str:
    """A row of the table; seeds of what failed stand in it."""
    outcomes: Counter[str] = Counter()
    failures: list[str] = []
    slowest_s = 0.0
    with tempfile.TemporaryDirectory() as folder:
        path = write_seed(name, Path(folder))
        content = path.read_bytes()
        read_or_refuse(path)
        before = _peak_bytes()
        resource.setrlimit(resource.RLIMIT_AS, (_address_space_bytes() + MEMORY_BYTES,) * 2)
        for seed in range(mutations):
            path.write_bytes(mutated(content, np.random.default_rng(seed)))
            start_s = time.perf_counter()
            try:
                outcomes["refused" if read_or_refuse(path) is None else "read"] += 1
            except BaseException as error:  # noqa: BLE001 - anything at all is a finding
                failures.append(f"seed {seed}: {type(error).__name__} {error}"[:150])
            slowest_s = max(slowest_s, time.perf_counter() - start_s)
        grown_mib = (_peak_bytes() - before) >> 20
    outcome = f"{len(failures)} FAILED, {failures[:3]}" if failures else "good"
    return f"| {name} | {outcomes['read']} | {outcomes['refused']} | {slowest_s:.2f} | {grown_mib} | {outcome} |"


def _peak_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10


def _address_space_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    return pages * resource.getpagesize()


if __name__ == "__main__":
    print(fuzz(sys.argv[1], int(sys.argv[2])))
