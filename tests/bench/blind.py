# SPDX-License-Identifier: Apache-2.0
"""A LiDAR that looks away from the two others."""

from __future__ import annotations

from collections import Counter

from multilica.config import CalibrationConfig
from tests.bench.simulated import SCENES, print_details
from tests.bench.support.cases import Case, LidarOutcome, run_case
from tests.bench.support.claims import Claim, print_claims, print_table
from tests.bench.support.workers import run_all

_CASES = [Case("blind", SCENES[index % len(SCENES)], 1001 + index, target="front_left") for index in range(20)]


def main() -> bool:
    """Print what became of both LiDARs, and whether the third was ever placed wrongly."""
    lidars = [lidar for found in run_all(_run, _CASES) for lidar in found]
    standings = ("within", "between", "wrong", "uncertain", "refused")
    counts = Counter((each.lidar, each.standing) for each in lidars)
    print_table(
        ("LiDAR", "sees", *standings),
        [
            (lidar, sees, *(counts[lidar, standing] for standing in standings))
            for lidar, sees in (("front_right", "half of what the target sees"), ("rear", "nothing of it"))
        ],
    )
    print_details([each for each in lidars if each.placed and each.standing != "within"])
    wrong = counts["rear", "wrong"]
    return print_claims([Claim("the third LiDAR wrongly placed, of 20", "0", str(wrong), wrong == 0)])


def _run(case: Case) -> list[LidarOutcome]:
    return run_case(case, CalibrationConfig())
