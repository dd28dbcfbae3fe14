# SPDX-License-Identifier: Apache-2.0
"""Real scans, both sources turned at random about their own origins."""

from __future__ import annotations

from collections import Counter
from math import degrees

import numpy as np
from scipy.spatial.transform import Rotation

from multilica.geometry import FloatArray
from multilica.pipeline import calibrate
from multilica.results import LidarPlacement
from multilica.runs import PoseError, Tolerances
from tests.bench.support.claims import Claim, print_claims, print_table
from tests.bench.support.workers import run_all
from tests.opencalib import CONFIG, DATA, MISSING, SOURCES, TRUTH, is_true, read_clouds, turned_snapshot, unturned

DRAWS = 60
STANDINGS = ("right", "beside", "wrong", "uncertain", "refused")


def main() -> bool:
    """Print how many of either source are right, and each that is not."""
    if not DATA.is_dir():
        return print_claims([Claim("real scans from random orientations", "all right", MISSING, holds=False)])
    rows = [row for found in run_all(_run, range(DRAWS)) for row in found]
    counts = Counter((row[1], row[2]) for row in rows)
    print_table(
        ("source", *STANDINGS),
        [(source, *(counts[source, standing] for standing in STANDINGS)) for source in SOURCES],
    )
    print_table(("draw", "source", "outcome", "why"), [row for row in rows if row[2] != "right"])
    right, wrong = (sum(counts[source, standing] for source in SOURCES) for standing in ("right", "wrong"))
    total = DRAWS * len(SOURCES)
    return print_claims(
        [
            Claim("real scans from random orientations: right", f"all {total}", str(right), right == total),
            Claim("the same: wrongly accepted", "0", str(wrong), wrong == 0),
        ]
    )


def _run(draw: int) -> list[tuple[int, str, str, str]]:
    """Draw, source, outcome and reason."""
    rotations = drawn_rotations(draw)
    result = calibrate(turned_snapshot(read_clouds(), rotations), CONFIG)
    return [(draw, source, *judged(result[source], rotations[source])) for source in SOURCES]


def drawn_rotations(draw: int) -> dict[str, FloatArray]:
    """The rotation (3, 3) by which each source is turned."""
    drawn = Rotation.random(len(SOURCES), random_state=np.random.default_rng([1001, draw])).as_matrix()
    return dict(zip(SOURCES, drawn, strict=True))


def judged(placement: LidarPlacement, rotation: FloatArray) -> tuple[str, str]:
    """Outcome and reason: `beside` is outside of what is known of the truth, yet not wrong by the usual limits."""
    if placement.T_target_source is None:
        return "refused", placement.reason
    if getattr(placement, "status", "") == "uncertain":
        return "uncertain", placement.reason
    found = unturned(placement.T_target_source, rotation)
    if is_true(found):
        return "right", ""
    error = PoseError.between(found, TRUTH[found.source])
    wrong = Tolerances().outcome(error) == "false_accept"
    off = f"off by {1e3 * error.distance_m:.0f} mm and {degrees(error.angle_rad):.2f} deg"
    return "wrong" if wrong else "beside", off
