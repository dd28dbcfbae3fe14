# SPDX-License-Identifier: Apache-2.0
"""Made pairs of four LiDARs at their true poses, with as much evidence as asked for."""

from dataclasses import replace

import numpy as np

from multilica.results import Registration, VisibilityScore
from tests.unit.made_pairs import ACCEPTED, pair, pose

IN_A = {
    "a": pose("a", "a"),
    "b": pose("a", "b", (0.5, 0.2, 0.0), 0.8),
    "c": pose("a", "c", (-0.5, 0.1, 0.1), -1.2),
    "d": pose("a", "d", (0.0, 0.9, 0.1), 2.0),
}


def true_pose(target, source):
    return IN_A[target].inverse() @ IN_A[source]


def scored(at, distinctive=600, violate=0):
    """Score a pose: 400 more points agree on the ground."""
    information = np.diag([50.0, 200, 200, 200, 200, 400.0])
    score = VisibilityScore(distinctive + 400, violate, 0, 0, information, np.zeros(0, dtype=np.uint8))
    return Registration(0, at, score, 0.8, 0.03, 5.0, np.zeros((0, 3)))


def registered(at, distinctive=600, verdict=ACCEPTED, competing=()):
    """Make a pair with the poses that compete with its own."""
    return pair(at, verdict, registrations=tuple(scored(each, distinctive) for each in (at, *competing)))


def linked(target, source, distinctive=600, verdict=ACCEPTED):
    """Make a pair at its true pose."""
    return registered(true_pose(target, source), distinctive, verdict)


def moved_to(made, at):
    """Put a pair elsewhere."""
    best, *others = made.registrations
    return replace(made, T_target_source=at, registrations=(replace(best, T_target_source=at), *others))
