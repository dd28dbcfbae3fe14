# SPDX-License-Identifier: Apache-2.0
"""Time of the stages with one thread, preset default against preset paper."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multilica.config import preset, with_overrides
from multilica.pipeline import calibrate
from multilica.simulate import simulate_snapshot
from multilica.snapshot import Snapshot
from tests.bench.claims import Claim, print_claims, print_table
from tests.opencalib import DATA, MISSING, read_clouds, turned_snapshot

__all__ = ["Lap", "claim", "main"]

_PRESETS = ("default", "paper")


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
    """Print the times, and whether the ratios hold."""
    claims = []
    if DATA.is_dir():
        claims.append(_measured("opencalib-0001", turned_snapshot(read_clouds(), {}), limit=0.7, repeats=3))
    else:
        claims.append(Claim("time on opencalib-0001 against paper", "<= 0.7 x", MISSING, holds=False))
    claims.append(_measured("edgar", simulate_snapshot("edgar", "street", 1001).snapshot, limit=0.5, repeats=1))
    return print_claims(claims)


def _measured(name: str, snapshot: Snapshot, limit: float, repeats: int) -> Claim:
    """The presets in turn, so that whatever else the machine does meets both."""
    laps = [[_lap(name, snapshot, preset_name) for preset_name in _PRESETS] for _ in range(repeats)]
    print_table(
        (name, "repeat", "stages s", "processor s"),
        [
            (preset_name, repeat, f"{lap.wall_s:.1f}", f"{lap.processor_s:.1f}")
            for repeat, pair in enumerate(laps)
            for preset_name, lap in zip(_PRESETS, pair, strict=True)
        ],
    )
    return claim(name, laps, limit)


def claim(name: str, laps: Sequence[Sequence[Lap]], limit: float) -> Claim:
    """The median ratio, by processor time; by wall time it is only told."""
    ratio, wall_ratio = (
        float(np.median([getattr(ours, time_s) / getattr(paper, time_s) for ours, paper in laps]))
        for time_s in ("processor_s", "wall_s")
    )
    measured = f"{ratio:.2f} ({wall_ratio:.2f} by wall time)"
    return Claim(f"time on {name} against paper", f"<= {limit:g} x", measured, ratio <= limit)


def _lap(name: str, snapshot: Snapshot, preset_name: str) -> Lap:
    config = with_overrides(preset(preset_name), ["runtime.threads=1"])
    start_s = time.process_time()
    result = calibrate(snapshot, config)
    lap = Lap(sum(result.timing_s.values()), time.process_time() - start_s)
    print(f"{name}, {preset_name}: {lap.wall_s:.0f} s", file=sys.stderr, flush=True)
    return lap
