# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from itertools import product

import pytest

from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.results import LidarPlacement
from multilica.runs import SavedRun, Truth
from multilica.simulate import simulate_snapshot
from tests.bench import tables
from tests.bench.support.cases import Case
from tests.bench.tables import KISS, PRESETS, SYSTEMS, TARGETS, Outcome

ROOM = {"top": (0.0, 0.0, 0.0), "left": (1.0, 2.0, 0.0), "right": (1.0, -2.0, 0.0)}


def _pose(name, xyz_m):
    return RigidTransform.from_xyz_rpy("top", name, xyz_m, (0.0, 0.0, 0.0))


def _outcome(system, rig, seed, off_m, *, placed=True, cpu_s=1.0):
    truth = Truth("truth", Extrinsics("top", {name: _pose(name, xyz_m) for name, xyz_m in ROOM.items()}))
    poses = {name: _pose(name, (x_m + off_m, y_m, z_m)) for name, (x_m, y_m, z_m) in ROOM.items()}
    poses["top"] = _pose("top", (0.0, 0.0, 0.0))
    placements = tuple(
        LidarPlacement(name, "", "placed", pose) if placed else LidarPlacement(name, "") for name, pose in poses.items()
    )
    return Outcome(
        system, Case(rig, "street", seed), SavedRun(f"{system} {rig} {seed}", "top", placements), truth, cpu_s
    )


@pytest.fixture(scope="module")
def page():
    """Errors along x: 3 and 4 mm with every system and rig, but for `kiss` on `edgar`, 60 mm, and `sides`, nothing."""
    outcomes = []
    for (system, rig), (seed, off_m) in product(product(SYSTEMS, TARGETS), ((1, 0.003), (2, 0.004))):
        odd = system == KISS and rig == "edgar"
        placed = not (system == KISS and rig == "sides")
        outcomes.append(_outcome(system, rig, seed, 0.06 if odd else off_m, placed=placed, cpu_s=float(seed)))
    return tables.page(outcomes)


def _rows(page, heading):
    section = page.split(f"## {heading}\n")[1].split("## ")[0]
    lines = [line.strip("| ").split(" | ") for line in section.splitlines() if line.startswith("| ")]
    return {tuple(row[:2]): row[2:] for row in lines}


def test_each_rig_has_a_row_per_system(page):
    rows = _rows(page, "To the target")
    assert [key for key in rows if key != ("rig", "system")][1:] == list(product((*TARGETS, "all"), SYSTEMS))
    assert rows["edgar", "default"][:5] == ["4", "4", "4", "0", "3.5"]
    assert rows["edgar", "default"][-3:] == ["3.5", "0.000", "1.5"]
    assert rows["edgar", KISS][:5] == ["4", "4", "0", "4", "60.0"]
    assert rows["sides", KISS] == ["4", "0", "0", "0", *["-"] * 9, "1.5"]
    assert rows["all", KISS][:4] == ["16", "12", "8", "4"]


def test_errors_that_lidars_share_vanish_between_them(page):
    rows = _rows(page, "Between LiDARs")
    assert rows["edgar", KISS][:4] == ["6", "6", "2", "4"]
    assert rows["edgar", "default"][:4] == ["6", "6", "6", "0"]


def test_the_page_says_what_it_was_made_with(page):
    assert all(f"`{name}`" in page for name in PRESETS)
    packages = {package for package, _ in _rows(page, "Versions")}
    assert {"multilica", "Python", "open3d-cpu", "small-gicp", "kiss-matcher"} <= packages
    assert ", ".join(map(str, tables.SEEDS)) in page


@pytest.mark.slow
@pytest.mark.nightly  # a push has the peer alone in test_measurements.py
def test_the_peer_and_a_preset_place_a_rig():
    case = Case("sides", "street", 77, (), "top")
    for system, place in (("default", tables._place_by_preset), (KISS, tables._place_by_peer)):
        simulation = simulate_snapshot(case.rig, case.scene, case.seed, sensors="ideal")
        run = SavedRun(system, case.target, tuple(place(system, simulation.snapshot, case.target)))
        outcome = Outcome(system, case, run, Truth("truth", simulation.truth), 1.0)
        assert {each.lidar for each in outcome.run.placements} == {"top", "left", "right"}
        (row,) = [tables.cells(tables._table([outcome]).rows)]
        assert row[:4] == ("2", "2", "2", "0")
