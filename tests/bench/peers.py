# SPDX-License-Identifier: Apache-2.0
"""The presets and the simplest peer on the same real scans, both sources turned at random about their own origins."""

from __future__ import annotations

import os
from collections import Counter
from itertools import product

import numpy as np

from multilica.config import preset, with_overrides
from multilica.geometry import FloatArray, RigidTransform
from multilica.pipeline import calibrate
from multilica.results import LidarPlacement
from tests.bench.real_scans import DRAWS, STANDINGS, drawn_rotations, judged
from tests.bench.support.claims import Claim, print_claims, print_table
from tests.bench.support.workers import run_all
from tests.opencalib import DATA, MISSING, SOURCES, read_clouds, turned_snapshot

KISS = "kiss"
SYSTEMS = ("default", "paper", KISS)


def main() -> bool:
    """Print how the poses of each system stand; nothing is claimed of others."""
    if not DATA.is_dir():
        return print_claims([Claim("real scans from random orientations", "a table", MISSING, holds=False)])
    tasks = list(product(SYSTEMS, range(DRAWS)))
    found = dict(zip(tasks, run_all(_run, tasks), strict=True))
    print_table(
        ("system", "poses", *STANDINGS),
        [row_of(system, [one for draw in range(DRAWS) for one in found[system, draw]]) for system in SYSTEMS],
    )
    return True


def row_of(system: str, standings: list[str]) -> tuple[object, ...]:
    """Count the standings of a system."""
    counts = Counter(standings)
    return (system, len(standings), *(counts[standing] for standing in STANDINGS))


def _run(task: tuple[str, int]) -> list[str]:
    system, draw = task
    rotations = drawn_rotations(draw)
    place = _place_by_peer if system == KISS else _place_by_preset
    placements = place(system, rotations)
    return [judged(placements[source], rotations[source])[0] for source in SOURCES]


def _place_by_preset(system: str, rotations: dict[str, FloatArray]) -> dict[str, LidarPlacement]:
    config = with_overrides(preset(system), ["target=top", "runtime.workers=1"])
    result = calibrate(turned_snapshot(read_clouds(), rotations), config)
    return {source: result[source] for source in SOURCES}


def _place_by_peer(system: str, rotations: dict[str, FloatArray]) -> dict[str, LidarPlacement]:
    from tests.bench.support.kiss_baseline import place

    # With several cores, KISS-Matcher's result differs from run to run.
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    clouds = {
        lidar.name: lidar.points_m.astype(np.float64) for lidar in turned_snapshot(read_clouds(), rotations).lidars
    }
    poses = {
        name: RigidTransform.from_rotation_translation("top", name, T[:3, :3], T[:3, 3])
        for name, T in place(clouds, "top").items()
    }
    return {name: LidarPlacement(name, system, "placed", pose) for name, pose in poses.items()}
