# SPDX-License-Identifier: Apache-2.0
"""The presets side by side on simulated rigs."""

from __future__ import annotations

from itertools import product

from multilica.config import preset
from tests.bench.simulated import COLUMNS, RIGS, figures
from tests.bench.support.cases import NEW_SEEDS, Case, LidarOutcome, run_case
from tests.bench.support.claims import print_table
from tests.bench.support.workers import run_all

__all__ = ["main"]

_SCENES = ("street", "parking", "garage")
# The last two are figures of the covariance, which the paper has none of.
_SHARED = len(COLUMNS) - 2
_PRESETS = ("default", "paper")


def main() -> bool:
    """Print figures per rig and preset; nothing is claimed of them."""
    cases = [Case(*each, seed) for *each, seed in product(RIGS, _SCENES, NEW_SEEDS[:1])]
    runs = list(product(_PRESETS, cases))
    found = dict(zip(runs, run_all(_run, runs), strict=True))
    rows = [
        (name, rig, [lidar for case in cases if case.rig == rig for lidar in found[name, case]])
        for rig, name in product(RIGS, _PRESETS)
    ]
    print_table(
        ("preset", "rig", *COLUMNS[:_SHARED]),
        [(name, rig, *figures(lidars)[:_SHARED]) for name, rig, lidars in rows],
    )
    return True


def _run(run: tuple[str, Case]) -> list[LidarOutcome]:
    name, case = run
    return run_case(case, preset(name))
