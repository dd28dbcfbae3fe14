# SPDX-License-Identifier: Apache-2.0
"""Rigs of many LiDARs, and of LiDARs far apart, with and without returns of the own vehicle."""

from __future__ import annotations

from itertools import product

from tests.bench.simulated import MASKS, report
from tests.bench.support.cases import NEW_SEEDS, Case

RIGS = ("ring6", "sectors8", "sectors20", "truck")
SCENES = ("street", "parking", "garage")
_SEEDS = NEW_SEEDS[:3]
_LEAST_GOOD = 0.98


def main() -> bool:
    """Print figures per rig, every LiDAR that is not good, and whether the claims hold."""
    return report([Case(*each) for each in product(RIGS, SCENES, _SEEDS, MASKS)], _LEAST_GOOD)
