# SPDX-License-Identifier: Apache-2.0
"""Tables and sentences of the report and of the terminal show the numbers of the result in the units they name."""

from __future__ import annotations

import pytest

from multilica_cli.commands.calibrate import print_run
from tests.sinks.numbers import made_numbers as made
from tests.sinks.numbers.expected import (
    LARGEST_AFTER_DEG,
    LARGEST_AFTER_MM,
    LARGEST_BEFORE_DEG,
    LARGEST_BEFORE_MM,
    POSED,
    farthest,
    placement_columns,
    pose_columns,
)
from tests.sinks.numbers.readers import Page, assert_figures, terminal_row

VERDICTS = ("merged", "merged uncertain", "uncertain")


@pytest.fixture(scope="module")
def page(numbered_run):
    return Page((numbered_run.directory / "report.html").read_text(encoding="utf-8"))


@pytest.fixture
def printed(numbered_run, capsys):
    print_run(numbered_run, quiet=False)
    return capsys.readouterr().out


def test_poses_of_the_report(page):
    (table,) = page.in_section("result")
    rows = table.named()
    assert f"relative to {made.TOP}" in table.caption
    for lidar in POSED:
        assert_figures(rows[lidar], {**placement_columns(lidar), "RMSE m": made.POSE_RMSE_MM[lidar] / 1000.0})
    assert_figures(rows[made.TOP], pose_columns(made.TOP))


def test_sentences_of_the_report(page):
    assert made.ground_sentence() in page.text
    assert (
        f"Joint refinement over 2 pairs: the largest disagreement is {LARGEST_AFTER_MM:.1f} mm and "
        f"{LARGEST_AFTER_DEG:.3f} deg. Before it was {LARGEST_BEFORE_MM:.1f} mm and {LARGEST_BEFORE_DEG:.3f} deg."
    ) in page.text
    for (target, source), fitness in made.PAIR_FITNESS.items():
        assert any(f"{source} on {target}: {word}, pair fitness {fitness:.3f}, " in page.text for word in VERDICTS)


def test_snapshots_of_the_report(page):
    (table,) = page.in_section("snapshots")
    for snapshot, cells in table.named().items():
        off_mm, off_deg = (max(each) for each in zip(*made.DEVIATIONS[snapshot].values(), strict=True))
        assert_figures(cells, {"off by m": off_mm / 1000.0, "off by deg": off_deg})


def test_pairs_of_the_report(page, numbered_run):
    matrix, pairs = page.in_section("pairs")
    assert "target in rows, source in columns" in matrix.caption
    filled = {
        (target, source): cell.split()[0]
        for target, cells in matrix.named().items()
        for source, cell in cells.items()
        if cell
    }
    assert filled == {pair: f"{fitness:.3f}" for pair, fitness in made.PAIR_FITNESS.items()}
    rows = pairs.named()
    assert len(rows) == len(made.PAIR_FITNESS)
    found = {(pair.target, pair.source): pair for pair in numbered_run.result.pairs}
    for (target, source), fitness in made.PAIR_FITNESS.items():
        agree, violate, occluded, _ = made.PAIR_COUNTS[target, source]
        expected = {
            "pair fitness": fitness,
            "evidence": found[target, source].evidence,
            "RMSE m": made.PAIR_RMSE_MM[target, source] / 1000.0,
        }
        counts = {"agree": agree, "violate": violate, "occluded": occluded}
        assert_figures(rows[f"{source} on {target}"], expected | counts)


def test_input_and_times_of_the_report(page):
    (table,) = page.in_section("input")
    for cells in table.named().values():
        assert_figures(cells, {"frames": 2, "points": 1200})
    (table,) = page.in_section("timings")
    assert {stage: float(cells["seconds"]) for stage, cells in table.named().items()} == made.SECONDS


def test_poses_of_the_terminal(printed):
    for lidar in POSED:
        compared = {
            "to prior m": made.PRIOR_SHIFT_MM[lidar] / 1000.0,
            "to prior deg": made.PRIOR_TURN_DEG[lidar],
            "spread m": max(made.SPREAD_MM[lidar]) / 1000.0,
            "spread deg": max(made.SPREAD_DEG[lidar]),
            "snap- shots": made.SNAPSHOTS[lidar],
        }
        assert_figures(terminal_row(printed, lidar), placement_columns(lidar) | compared)
    assert_figures(terminal_row(printed, made.TOP), pose_columns(made.TOP))
    assert f"T_target_source, target {made.TOP}" in printed


def test_sentences_of_the_terminal(printed):
    assert made.ground_sentence() in " ".join(printed.split())
    for snapshot in made.DEVIATIONS:
        lidar, off_mm, off_deg = farthest(snapshot)
        assert f"snapshot {snapshot}: agrees: {lidar} is off most, by {off_mm:.1f} mm, {off_deg:.3f} deg" in printed
    assert "sigma 32.1 mm mostly along z of top, limit 20 mm" in printed
