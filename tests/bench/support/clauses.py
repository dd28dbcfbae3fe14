# SPDX-License-Identifier: Apache-2.0
"""The preset `default` with one clause at a time as in the paper, a program of its own for `docs/paper.md`."""

from __future__ import annotations

from itertools import product

from multilica.config import preset, with_overrides
from multilica.runs import SavedRun, Truth
from multilica.runs.paper_table import PaperRow, paper_table
from multilica.simulate import simulate_snapshot
from tests.bench.__main__ import one_thread_each
from tests.bench.support.cases import Case
from tests.bench.support.claims import print_table
from tests.bench.support.workers import run_all
from tests.bench.tables import COLUMNS, TARGETS, cells, place_by_config

CLAUSES = {
    "default": (),
    "normals not oriented": ("features.orient_normals=false",),
    "normals of 5 voxels, 100 points": ("features.normal_radius_voxels=5", "features.normal_neighbours=100"),
    "descriptors up to 25 m": ("features.max_range_m=25",),
    "edges by lengths alone": ("coarse.normal_tolerance_deg=180",),
    "one hypothesis": ("coarse.max_hypotheses=1",),
    "accepted by fitness": ("verify.enabled=false",),
    "GICP on 5 cm": ("fine.voxel_size_m=0.05",),
    "GICP within 1 m only": ("fine.max_correspondence_distances_m=[1.0]",),
    "no adjustment over loops": ("refine.enabled=false",),
}
"""Clause of the paper -> settings."""
RIGS = ("sides", "chain")
"""Those with the least overlap, where a clause makes the largest difference."""
SCENES = ("street", "garage")
SEED = 701
"""Not among the seeds of the other measurements."""


def main() -> None:
    """Print a row per clause; nothing is claimed."""
    cases = [Case(rig, scene, SEED, (), TARGETS[rig]) for rig, scene in product(RIGS, SCENES)]
    tasks = list(product(CLAUSES, cases))
    found = dict(zip(tasks, run_all(_run, tasks), strict=True))
    rows = {clause: [one for case in cases for one in found[clause, case]] for clause in CLAUSES}
    print_table(("clause", *COLUMNS), [(clause, *cells(errors)) for clause, errors in rows.items()])


def _run(task: tuple[str, Case]) -> tuple[PaperRow, ...]:
    clause, case = task
    simulation = simulate_snapshot(case.rig, case.scene, case.seed)
    config = with_overrides(preset("default"), [f"target={case.target}", "runtime.workers=1", *CLAUSES[clause]])
    run = SavedRun(f"{clause} {case}", case.target, tuple(place_by_config(config, simulation.snapshot)))
    return paper_table([run], [Truth(str(case), simulation.truth)]).rows


if __name__ == "__main__":
    one_thread_each()
    main()
