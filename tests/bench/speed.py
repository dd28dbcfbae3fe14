# SPDX-License-Identifier: Apache-2.0
"""Time of the stages with one thread, preset default against preset paper."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache

import numpy as np

from multilica.config import preset, with_overrides
from multilica.pipeline import calibrate
from multilica.simulate import simulate_snapshot
from multilica.snapshot import Snapshot
from tests.bench.support.claims import Claim, print_claims, print_table
from tests.bench.support.workers import run_all
from tests.opencalib import DATA, MISSING, read_clouds, turned_snapshot

__all__ = ["Lap", "claim", "main"]

_PRESETS = ("default", "paper")
_REAL, _SIMULATED = "opencalib-0001", "edgar"


@dataclass(frozen=True, slots=True)
class Lap:
    """One run of one preset.

    Args:
        wall_s: what the stages took; on a busy machine that is the work of others, too.
        processor_s: what they took of the processor, which is the time of one thread on an idle machine.
    """

    wall_s: float
    processor_s: float


def main() -> bool:
    """Print the times, and whether the ratios stability."""
    claims = []
    if DATA.is_dir():
        claims.append(_measured(_REAL, limit=0.7, repeats=3))
    else:
        claims.append(Claim(f"time on {_REAL} against paper", "<= 0.7 x", MISSING, holds=False))
    claims.append(_measured(_SIMULATED, limit=0.5, repeats=1))
    return print_claims(claims)


def _measured(name: str, limit: float, repeats: int) -> Claim:
    """The presets in turn, so that whatever else the machine does meets both."""
    cases = [(name, preset_name, repeat) for repeat in range(repeats) for preset_name in _PRESETS]
    with _on_one_core():
        laps = run_all(_lap, cases)
    print_table(
        (name, "repeat", "stages s", "processor s"),
        [
            (preset_name, repeat, f"{lap.wall_s:.1f}", f"{lap.processor_s:.1f}")
            for (_, preset_name, repeat), lap in zip(cases, laps, strict=True)
        ],
    )
    return claim(name, list(zip(laps[::2], laps[1::2], strict=True)), limit)


@contextmanager
def _on_one_core() -> Iterator[None]:
    """Open3D's GICP takes all cores that its process finds at its start, whatever it is told."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


@cache
def _snapshot(name: str) -> Snapshot:
    if name == _REAL:
        return turned_snapshot(read_clouds(), {})
    return simulate_snapshot(name, "street", 1001).snapshot


def _lap(case: tuple[str, str, int]) -> Lap:
    name, preset_name, _ = case
    snapshot = _snapshot(name)
    config = with_overrides(preset(preset_name), ["runtime.threads=1"])
    start_s = time.process_time()
    result = calibrate(snapshot, config)
    return Lap(sum(result.timing_s.values()), time.process_time() - start_s)


def claim(name: str, laps: Sequence[Sequence[Lap]], limit: float) -> Claim:
    """The median ratio, by processor time; by wall time it is only told."""
    ratio, wall_ratio = (
        float(np.median([getattr(ours, time_s) / getattr(paper, time_s) for ours, paper in laps]))
        for time_s in ("processor_s", "wall_s")
    )
    measured = f"{ratio:.2f} ({wall_ratio:.2f} by wall time)"
    return Claim(f"time on {name} against paper", f"<= {limit:g} x", measured, ratio <= limit)
