# SPDX-License-Identifier: Apache-2.0
"""Sides of a registration: LiDARs and groups."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from multilica.acceptance.accept import accept, accept_by_fitness
from multilica.geometry import FloatArray
from multilica.results import (
    Group,
    Hypothesis,
    PairKey,
    PairRegistration,
)
from multilica.stages.fine import Side, prepare_side, register_best
from multilica.steps.state import CalibrationState

__all__ = ["merged_points", "register_pair", "register_sides", "side_of"]


def side_of(state: CalibrationState, group: Group) -> Side:
    """Prepare a LiDAR, or a group with its members in the frame of its root, for registration."""
    if len(group.poses) == 1 and group.root in state.sides:
        return state.sides[group.root]
    placed = sorted(group.poses.items()) if state.prepared else []
    views = [(pose, state.prepared[name].view) for name, pose in placed]
    return prepare_side(group.root, merged_points(state, group), views, state.config)


def merged_points(state: CalibrationState, group: Group) -> FloatArray:
    """Return the points (N, 3) of all members in the frame of the root."""
    return np.concatenate([pose.apply(state.clouds[name].points_m) for name, pose in sorted(group.poses.items())])


def register_sides(
    state: CalibrationState, target: Side, source: Side, hypotheses: Sequence[Hypothesis], *, fit: bool
) -> PairRegistration:
    """Register two sides from the best of several hypotheses, with a verdict.

    Args:
        fit: off: without the fit to planes, and so without information.
    """
    config = state.config
    found = register_best(target, source, hypotheses, config, fit=fit)
    if found.registrations:
        return replace(found, verdict=accept(found.registrations, config.acceptance, config.stability))
    return replace(found, verdict=accept_by_fitness(found, config.merge))


def register_pair(state: CalibrationState, pair: PairKey, hypotheses: Sequence[Hypothesis]) -> PairRegistration:
    """Register two LiDARs from the best of several hypotheses, with a verdict."""
    return register_sides(state, state.sides[pair[0]], state.sides[pair[1]], hypotheses, fit=True)
