# SPDX-License-Identifier: Apache-2.0
"""Cost with more LiDARs, with pairs that share nothing, and with more workers; it needs two idle cores."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from tests.bench.support.claims import Claim, at_most, print_claims, print_table
from tests.bench.support.process_cost import Cost
from tests.bench.support.recordings import SAMPLE, calibration_cost, record

_REPEATS = 3
_RIGS = ("edgar", "blind", "chain", "sectors8", "sectors20")
_TWO_WORKERS = ("sample", "sectors8")

Runs = Mapping[tuple[str, int], Sequence[Cost]]
"""Name of the recording and number of workers -> the cost of each repeat."""


def main() -> bool:
    """Print each run, and whether the claims hold."""
    runs: dict[tuple[str, int], list[Cost]] = {}
    with tempfile.TemporaryDirectory() as folder:
        recordings = {"sample": SAMPLE} | {rig: record(Path(folder), rig, "street") for rig in _RIGS}
        cases = [(name, 1) for name in recordings] + [(name, 2) for name in _TWO_WORKERS]
        for _ in range(_REPEATS):
            for name, workers in cases:
                runs.setdefault((name, workers), []).append(calibration_cost(recordings[name], "--workers", workers))
    print_table(
        ("recording", "workers", "CPU s", "wall s", "largest process MB"),
        [
            (*case, f"{cost.cpu_s:.1f}", f"{cost.wall_s:.1f}", f"{cost.memory_mb:.0f}")
            for case, costs in runs.items()
            for cost in costs
        ],
    )
    return print_claims(claims(runs))


def claims(runs: Runs) -> list[Claim]:
    """What must be seen to hold of them."""
    return [
        *(
            at_most(f"wall of {name}, 2 workers against 1", _ratios(runs, (name, 2), (name, 1), _wall_s), 0.65, "x")
            for name in _TWO_WORKERS
        ),
        at_most(
            "CPU of sectors20 against sectors8", _ratios(runs, ("sectors20", 1), ("sectors8", 1), _cpu_s), 3.0, "x"
        ),
        *(
            at_most(f"CPU of {rig} against edgar", _ratios(runs, (rig, 1), ("edgar", 1), _cpu_s), 1.0, "x")
            for rig in ("blind", "chain")
        ),
        at_most("memory of sectors20, 1 worker", [cost.memory_mb for cost in runs["sectors20", 1]], 1000.0, "MB"),
    ]


def _ratios(runs: Runs, case: tuple[str, int], other: tuple[str, int], measure: Callable[[Cost], float]) -> list[float]:
    return [measure(cost) / measure(beside) for cost, beside in zip(runs[case], runs[other], strict=True)]


def _cpu_s(cost: Cost) -> float:
    return cost.cpu_s


def _wall_s(cost: Cost) -> float:
    return cost.wall_s
