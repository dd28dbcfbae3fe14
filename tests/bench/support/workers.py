# SPDX-License-Identifier: Apache-2.0
"""Cases spread over processes."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import TypeVar

from multilica.workers import processes

_MOST_WORKERS = 2
_Case = TypeVar("_Case")
_Outcome = TypeVar("_Outcome")


def run_all(run: Callable[[_Case], _Outcome], cases: Sequence[_Case], *, fresh: bool = False) -> list[_Outcome]:
    """The outcomes in the order of the cases; a line on stderr as each ends.

    Args:
        run: a function of a module, so that another process finds it.
        fresh: each case in a process of its own.
    """
    start = time.perf_counter()
    # Spawned: the engines' threads do not survive a fork.
    tasks = 1 if fresh else None
    with ProcessPoolExecutor(_workers(), get_context("spawn"), _one_core, max_tasks_per_child=tasks) as pool:
        futures = {pool.submit(run, case): index for index, case in enumerate(cases)}
        for done, future in enumerate(as_completed(futures), 1):
            elapsed_s = time.perf_counter() - start
            case = _named(cases[futures[future]])
            print(f"{done} of {len(cases)}, {elapsed_s:.0f} s: {case}", file=sys.stderr, flush=True)
        return [future.result() for future in futures]


def _one_core() -> None:
    """Have each calibration start no workers of its own, unless its configuration says so."""
    processes.available_cores = lambda: 1


def _named(case: object) -> str:
    return " ".join(map(str, case)) if isinstance(case, tuple) else str(case)


def _workers() -> int:
    """As many as the machine lets this process have: `taskset --cpu-list 0` asks for one."""
    return min(_MOST_WORKERS, len(os.sched_getaffinity(0)))
