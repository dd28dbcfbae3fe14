# SPDX-License-Identifier: Apache-2.0
"""The tables of the paper for the presets and the simplest peer, on simulated rigs, as `docs/benchmark.md`."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from itertools import product
from multiprocessing import current_process
from pathlib import Path
from statistics import median

import numpy as np

import multilica
from multilica.config import CalibrationConfig, preset, with_overrides
from multilica.errors import UnfitSnapshotError
from multilica.geometry import RigidTransform
from multilica.pipeline import calibrate
from multilica.results import LidarPlacement
from multilica.runs import PoseError, SavedRun, Tolerances, Truth
from multilica.runs.paper_table import AxisFigures, PaperRow, PaperTable, paper_table, summarise
from multilica.simulate import simulate_snapshot
from multilica.snapshot import Snapshot
from tests.bench.support.cases import NEW_SEEDS, Case
from tests.bench.support.workers import run_all

KISS = "kiss"
PRESETS = ("default", "paper")
SYSTEMS = (*PRESETS, KISS)
TARGETS = {"edgar": "left", "helipr": "ouster", "sides": "top", "chain": "front_left"}
"""Rig -> target LiDAR: the reference of the paper's truth, the one on the roof, one in the middle of the chain."""
SCENES = ("street", "garage")
SEEDS = NEW_SEEDS[:3]
_LIBRARIES = ("numpy", "scipy", "open3d-cpu", "small-gicp", "kiss-matcher")
_PAGE = Path(__file__).resolve().parents[2] / "docs" / "benchmark.md"
_LIMITS = Tolerances()
COLUMNS = (
    "poses",
    "placed",
    "success",
    "wrong",
    *(f"{axis} mm" for axis in "xyz"),
    *(f"{angle} deg" for angle in ("roll", "pitch", "yaw", "angle")),
    "median mm",
    "median deg",
)


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """One system on one snapshot.

    Args:
        cpu_s: of the calibration, without reading, writing and the imports of Python.
    """

    system: str
    case: Case
    run: SavedRun
    truth: Truth
    cpu_s: float


def main() -> bool:
    """Write the page; nothing is claimed."""
    cases = [Case(rig, scene, seed, (), TARGETS[rig]) for rig, scene, seed in product(TARGETS, SCENES, SEEDS)]
    outcomes = run_all(_run, list(product(SYSTEMS, cases)))
    _PAGE.write_text(page(outcomes), encoding="utf-8")
    print(f"wrote {_PAGE.name}")
    return True


def _run(task: tuple[str, Case]) -> Outcome:
    system, case = task
    simulation = simulate_snapshot(case.rig, case.scene, case.seed)
    place = _place_by_peer if system == KISS else _place_by_preset
    _take_one_core()
    _warm_up(system)
    start_s = time.process_time()
    placements = place(system, simulation.snapshot, case.target)
    cpu_s = time.process_time() - start_s
    run = SavedRun(f"{system} {case}", case.target, tuple(placements))
    return Outcome(system, case, run, Truth(str(case), simulation.truth), cpu_s)


def _take_one_core() -> None:
    """Keep the libraries' pools of threads to one core: with several, KISS-Matcher's result differs from run to run."""
    cores = sorted(os.sched_getaffinity(0))
    worker = next(iter(current_process()._identity), 0)
    os.sched_setaffinity(0, {cores[worker % len(cores)]})


def _warm_up(system: str) -> None:
    """Import what a calibration imports."""
    cloud = np.random.default_rng(0).uniform(-20.0, 20.0, (2000, 3))
    if system != KISS:
        from multilica.registration.lazy_open3d import o3d

        o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud))
        return
    import tests.bench.support.kiss_baseline  # noqa: F401


def _place_by_preset(system: str, snapshot: Snapshot, target: str) -> list[LidarPlacement]:
    return place_by_config(with_overrides(preset(system), [f"target={target}", "runtime.workers=1"]), snapshot)


def place_by_config(config: CalibrationConfig, snapshot: Snapshot) -> list[LidarPlacement]:
    """Calibrate; of a snapshot that is refused, no LiDAR is placed."""
    try:
        return list(calibrate(snapshot, config).placements)
    except UnfitSnapshotError as error:
        return [LidarPlacement(name, str(error)) for name in snapshot.names]


def _place_by_peer(_: str, snapshot: Snapshot, target: str) -> list[LidarPlacement]:
    from tests.bench.support.kiss_baseline import place

    poses = place({lidar.name: lidar.points_m for lidar in snapshot.lidars}, target)
    poses[target] = np.eye(4)
    return [
        LidarPlacement(
            name, KISS, "placed", RigidTransform.from_rotation_translation(target, name, T[:3, :3], T[:3, 3])
        )
        for name, T in poses.items()
    ]


def page(outcomes: Sequence[Outcome]) -> str:
    """Return the page in Markdown."""
    groups = {
        (rig, system): [each for each in outcomes if each.system == system and rig in (each.case.rig, "all")]
        for rig, system in product((*TARGETS, "all"), SYSTEMS)
    }
    tables = {key: _table(group) for key, group in groups.items()}
    cpu_s = {key: median(each.cpu_s for each in group) for key, group in groups.items()}
    return "\n".join(
        [
            _head(),
            "## To the target\n",
            _markdown(
                ("rig", "system", *COLUMNS, "CPU s"),
                [(*key, *cells(table.rows), f"{cpu_s[key]:.1f}") for key, table in tables.items()],
            ),
            "## Between LiDARs\n",
            "The same figures for any two LiDARs of a rig.\n",
            _markdown(
                ("rig", "system", *COLUMNS), [(*key, *cells(table.between_rows)) for key, table in tables.items()]
            ),
            "## Versions\n",
            _markdown(("package", "version"), list(_versions().items())),
        ]
    )


def _head() -> str:
    rigs = ", ".join(f"`{rig}` ({target})" for rig, target in TARGETS.items())
    scenes, presets = (", ".join(f"`{name}`" for name in names) for names in (SCENES, PRESETS))
    seeds = ", ".join(map(str, SEEDS))
    within = f"{1e3 * _LIMITS.within_m:g} mm and {_LIMITS.within_deg:g} degrees"
    wrong = f"{1e3 * _LIMITS.wrong_m:g} mm or {_LIMITS.wrong_deg:g} degrees"
    return f"""# Benchmark

`make bench-tables` writes this page: the tables of the paper on simulated rigs, with exact truth.

- Rigs, with the target: {rigs}.
- Scenes: {scenes}. Seeds: {seeds}. Each LiDAR has 5 frames.
- The LiDARs have [the systematic errors of real ones](certainty.md). Figures of scenes that repeat, with
  the coverage of sigma, are [with the limits](limits.md#scenes-that-repeat-with-traffic).
- Systems: the presets {presets}, and `kiss`: KISS-Matcher and small_gicp of each LiDAR against
  the target, with the libraries' own defaults. `kiss` accepts every pose, so it places every LiDAR.
- x, y, z, roll, pitch, yaw and angle are the RMSE over all scenes and LiDARs, as in the paper. They cover every
  pose that is given, so one wrong pose outweighs all others. The medians describe the other poses.
- success: off by at most {within}. wrong: given, and off by more than {wrong}. The paper states neither limit.
- CPU s: median per snapshot in one process, without reading, writing and imports.
"""


def _table(outcomes: Sequence[Outcome]) -> PaperTable:
    return paper_table([each.run for each in outcomes], [each.truth for each in outcomes], _LIMITS)


def cells(pairs: Sequence[PaperRow]) -> tuple[str, ...]:
    """Format errors for the columns of the page."""
    summary = summarise(pairs)
    errors = [one.error for one in pairs if one.error is not None]
    counts = (summary.poses, summary.placed, summary.successes, sum(map(_is_wrong, errors)))
    return *map(str, counts), *_error_cells(summary.rmse, errors)


def _error_cells(rmse: AxisFigures, errors: Sequence[PoseError]) -> tuple[str, ...]:
    if not errors:
        return ("-",) * 9
    values = rmse.model_dump()
    return (
        *(f"{1e3 * values[f'{axis}_m']:.1f}" for axis in "xyz"),
        *(f"{values[f'{name}_deg']:.3f}" for name in ("roll", "pitch", "yaw", "angle")),
        f"{1e3 * median(one.distance_m for one in errors):.1f}",
        f"{median(one.angle_deg for one in errors):.3f}",
    )


def _is_wrong(error: PoseError) -> bool:
    return error.distance_m > _LIMITS.wrong_m or error.angle_deg > _LIMITS.wrong_deg


def _markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join([*(f"| {' | '.join(line)} |" for line in lines), ""])


def _versions() -> dict[str, str]:
    known = {"multilica": multilica.__version__, "Python": platform.python_version()}
    return known | {name: version(name) for name in _LIBRARIES}
