# SPDX-License-Identifier: Apache-2.0
"""Registrations of a pair with made-up scores."""

import numpy as np

from multilica.results import Registration, VisibilityScore
from tests.unit.made_pairs import pose

HERE = pose("t", "s")
ELSEWHERE = pose("t", "s", (3.0, 4.0, 0.0), np.pi / 2)


def registration(at=HERE, *, distinctive=400, violate=0, structure=(200, 0), weakest=50.0, stability=None):
    """Make a registration whose points agree on the ground and, the distinctive ones, off it.

    Args:
        structure: number of its points that agree, and that are hidden.
        weakest: smallest eigenvalue of the information.
    """
    ground = 1000.0
    information = np.diag([weakest, 500.0, 500.0, 500.0, 500.0, ground])
    agree, (seen, hidden) = distinctive + int(ground), structure
    score = VisibilityScore(agree, violate, 0, 0, information, np.zeros(0, dtype=np.uint8), seen, 0, hidden)
    return Registration(0, at, score, 0.8, 0.03, 5.0, np.zeros((0, 3)), stability=stability)
