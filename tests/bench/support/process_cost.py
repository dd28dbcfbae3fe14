# SPDX-License-Identifier: Apache-2.0
"""What a command costs, with all processes that it starts.

The command runs below a process of its own that is small, since a process inherits the peak memory of the one that it
was forked from, and that adopts orphans, since a pool of workers may outlive the process that started it.
"""

from __future__ import annotations

import ctypes
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass

_SET_CHILD_SUBREAPER = 36
_PYTHON = (sys.executable, "-m")


@dataclass(frozen=True, slots=True)
class Cost:
    """What a command and its processes took.

    Args:
        cpu_s: user and system time of all of them.
        wall_s: until the command itself ended.
        memory_mb: the peak of the largest process.
        output: what the command printed.
    """

    cpu_s: float
    wall_s: float
    memory_mb: float
    output: str


def cost_of(module: str, *arguments: object, cores: int | None = None, codes: Sequence[int] = (0,)) -> Cost:
    """Run a Python module as a program.

    Args:
        cores: how many it may use; None for all.
        codes: of these one must be its exit code.

    Raises:
        RuntimeError: it ended with another exit code.
    """
    allowed = sorted(os.sched_getaffinity(0))[:cores]
    task = json.dumps({"command": [*_PYTHON, module, *map(str, arguments)], "cores": allowed})
    done = subprocess.run([*_PYTHON, __name__, task], check=True, stdout=subprocess.PIPE, text=True)
    code, cost = json.loads(done.stdout)
    if code not in codes:
        raise RuntimeError(f"{module} {' '.join(map(str, arguments))} ended with {code}")
    return Cost(**cost)


def _measure(command: list[str], cores: list[int]) -> tuple[int, Cost]:
    ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    os.sched_setaffinity(0, cores)
    start_s = time.perf_counter()
    keeping_bytecode = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    done = subprocess.run(command, check=False, stdout=subprocess.PIPE, text=True, env=keeping_bytecode)
    wall_s = time.perf_counter() - start_s
    with suppress(ChildProcessError):
        while True:
            os.wait()
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return done.returncode, Cost(usage.ru_utime + usage.ru_stime, wall_s, usage.ru_maxrss * 1024 / 1e6, done.stdout)


if __name__ == "__main__":
    exit_code, measured = _measure(**json.loads(sys.argv[1]))
    print(json.dumps([exit_code, asdict(measured)]))
