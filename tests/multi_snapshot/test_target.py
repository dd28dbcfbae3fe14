# SPDX-License-Identifier: Apache-2.0
"""The choice of the target of a joint result."""

from multilica.geometry import RigidTransform
from multilica.multi_snapshot.target import choose_target
from multilica.results import PairRegistration


def _edge(target, source, fitness):
    pose = RigidTransform.identity(target, source)
    return PairRegistration(
        target, source, pose, fitness, rmse_m=0.1, inliers=9, converged=True, iterations=1, engine=""
    )


def test_rounding_does_not_break_a_tie():
    """0.3 + 0.2 + 0.1 and 0.1 + 0.2 + 0.3 differ in the last bit."""
    names, fitness = "XYZ", (0.3, 0.2, 0.1)
    edges = tuple(_edge("A", name, each) for name, each in zip(names, fitness, strict=True))
    edges += tuple(_edge("B", name, each) for name, each in zip(names, reversed(fitness), strict=True))
    target, reason = choose_target({"only": edges}, ["A", "B", *names], "")
    assert target == "A"
    assert reason == "most overlap in 1 of 1 snapshots"
