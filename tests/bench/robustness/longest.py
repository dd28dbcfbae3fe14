# SPDX-License-Identifier: Apache-2.0
"""CPU time of every rig of up to eight LiDARs in every scene that can be decided."""

from __future__ import annotations

import tempfile
from itertools import product
from pathlib import Path

from multilica.simulate import RIGS
from tests.bench.support.claims import at_most, print_claims, print_table
from tests.bench.support.process_cost import Cost
from tests.bench.support.recordings import ONE_WORKER, calibration_cost, record
from tests.bench.support.workers import run_all

_SCENES = ("street", "parking", "garage")
_MOST_LIDARS = 8
_LIMIT_S = 40.0


def main() -> bool:
    """Print the time of each, and whether the longest holds."""
    cases = list(product((name for name, rig in RIGS.items() if len(rig.mounts) <= _MOST_LIDARS), _SCENES))
    costs = run_all(_cost, cases)
    print_table(
        ("rig", "scene", "CPU s", "wall s", "MB"),
        [
            (*case, f"{cost.cpu_s:.1f}", f"{cost.wall_s:.1f}", f"{cost.memory_mb:.0f}")
            for case, cost in zip(cases, costs, strict=True)
        ],
    )
    return print_claims([at_most("CPU of the longest", [max(cost.cpu_s for cost in costs)], _LIMIT_S, "s")])


def _cost(case: tuple[str, str]) -> Cost:
    with tempfile.TemporaryDirectory() as folder:
        return calibration_cost(record(Path(folder), *case), *ONE_WORKER)
