# SPDX-License-Identifier: Apache-2.0
"""Distances between the surfaces of LiDARs in their final poses."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from multilica.geometry import RigidTransform
from multilica.registration.gicp import GicpCloud
from multilica.results import IndexArray, SurfaceMatches, SurfaceResiduals

PairMatches = tuple[SurfaceMatches, IndexArray]
"""Matches of a pair with the rows of the source's cloud that they belong to."""


def match_surfaces(
    target: GicpCloud, source: GicpCloud, pose: RigidTransform, distance_m: float, most: int
) -> PairMatches:
    """Match each source point with the nearest target point within a distance, as fitness counts them.

    Args:
        pose: ``T_target_source``.
        most: largest number of source points that are matched; more are thinned evenly.
    """
    rows = np.arange(len(source.points_m))
    if len(rows) > most:
        rows = np.linspace(0, len(rows) - 1, most).astype(np.int64)
    moved_m = pose.apply(source.points_m[rows])
    near, distances_m, index = target.tree.nearest_within(moved_m, distance_m)
    normals, _ = target.surface.at(index)
    planes_m = np.abs(((moved_m[near] - target.points_m[index]) * normals).sum(axis=1))
    matches = SurfaceMatches(
        target.name,
        source.name,
        pose,
        target.points_m[index],
        source.points_m[rows[near]],
        distances_m,
        np.minimum(planes_m, distances_m),
    )
    return matches, rows[near]


def residuals_of(source: GicpCloud, found: Iterable[PairMatches]) -> SurfaceResiduals:
    """Return the residual at each point of a LiDAR that any of the others saw: the smallest to any of them."""
    residual_m = np.full(len(source.points_m), np.inf)
    for matches, rows in found:
        residual_m[rows] = np.minimum(residual_m[rows], matches.plane_distance_m)
    seen = np.flatnonzero(np.isfinite(residual_m))
    return SurfaceResiduals(source.name, source.points_m[seen], residual_m[seen])
