# SPDX-License-Identifier: Apache-2.0
"""How many LiDARs of each simulated rig end where they are, by preset."""

from __future__ import annotations

import os
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from itertools import product

import numpy as np

from multilica.config import preset
from tests.bench.cases import Outcome, run_case

RIGS = ("edgar", "helipr", "sides", "chain")
SCENES = ("street", "parking", "garage")
SEEDS = (101, 102, 103)
PRESETS = ("default", "paper")


def main() -> None:
    """Print the table."""
    cases = list(product(RIGS, SCENES, SEEDS))
    found: dict[tuple[str, str], list[Outcome]] = defaultdict(list)
    seconds: dict[tuple[str, str], list[float]] = defaultdict(list)
    with ProcessPoolExecutor(min(2, os.cpu_count() or 1)) as pool:
        for case, runs in zip(cases, pool.map(_run, cases), strict=True):
            for name, (lidars, elapsed_s) in zip(PRESETS, runs, strict=True):
                found[case[0], name] += lidars
                seconds[case[0], name].append(elapsed_s)
    print("| rig | preset | LiDARs | within 2 cm, 0.1 deg | wrong | refused | median mm | median deg | s per run |")
    print("|---|---|---|---|---|---|---|---|---|")
    for (rig, name), lidars in sorted(found.items()):
        print(_row(rig, name, lidars, float(np.median(seconds[rig, name]))))


def _run(case: tuple[str, str, int]) -> list[tuple[list[Outcome], float]]:
    return [(lidars, elapsed_s) for lidars, _, elapsed_s in run_case(*case, (preset(name) for name in PRESETS))]


def _row(rig: str, name: str, lidars: list[Outcome], elapsed_s: float) -> str:
    placed = [lidar for lidar in lidars if lidar.placed]
    millimetres = 1e3 * float(np.median([lidar.error_m for lidar in placed])) if placed else float("nan")
    degrees = float(np.median([lidar.error_deg for lidar in placed])) if placed else float("nan")
    good, wrong = sum(lidar.good for lidar in lidars), sum(lidar.wrong for lidar in lidars)
    return (
        f"| {rig} | {name} | {len(lidars)} | {good} | {wrong} | {len(lidars) - len(placed)} "
        f"| {millimetres:.1f} | {degrees:.3f} | {elapsed_s:.1f} |"
    )
