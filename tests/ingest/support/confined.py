# SPDX-License-Identifier: Apache-2.0
"""Reading in a process with hard limits of memory and time."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]
MB = 1_000_000

_SCRIPT = """
import resource, sys, time
from multilica.config import IngestConfig
from multilica.errors import MultilicaError
from multilica.ingest import inspect_source, read_snapshot
read_snapshot(sys.argv[1])
pages = int(open("/proc/self/statm").read().split()[0])
most = pages * resource.getpagesize() + int(sys.argv[3])
resource.setrlimit(resource.RLIMIT_AS, (most, most))
start_s = time.process_time()
config = IngestConfig(max_memory_mb=int(sys.argv[4]))
for read in (read_snapshot, inspect_source):
    try:
        found = read(sys.argv[2], config=config)
        print("READ", " ".join(getattr(found, "notes", ())), getattr(found, "objection", ""))
    except MultilicaError as error:
        print("REFUSED", type(error).__name__, error)
print(round(time.process_time() - start_s, 2))
"""


def read_confined(
    path: Path, warm_up: Path, *, memory_mb: int = 600, budget_mb: int = 300, seconds: float = 120.0
) -> tuple[str, str, float]:
    """Return how reading and inspecting a file end, and their CPU time, with `memory_mb` more than at the start.

    `warm_up` is a whole file of the format, which loads the libraries before memory is limited.
    """
    command = [sys.executable, "-c", _SCRIPT, str(warm_up), str(path), str(memory_mb * MB), str(budget_mb)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    ended = subprocess.run(command, capture_output=True, text=True, timeout=seconds, env=environment, check=False)
    assert ended.returncode == 0, ended.stderr[-2000:]
    snapshot, summary, taken_s = ended.stdout.splitlines()
    return snapshot, summary, float(taken_s)
