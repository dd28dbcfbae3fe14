# SPDX-License-Identifier: Apache-2.0
"""Matches of a pair at a pose."""

import numpy as np

from multilica.geometry import FloatArray, RigidTransform
from multilica.results import BoolArray, Correspondences, Hypothesis
from multilica.sinks.drawing.thinning import sample_indices
from multilica.sinks.run_state import RunState

__all__ = ["kept_matches", "match_lines"]


def kept_matches(state: RunState, matches: Correspondences, hypothesis: Hypothesis) -> BoolArray:
    """Return which matches (M,) agree with the hypothesis, by distance if the solver does not say."""
    if len(hypothesis.inliers) == len(matches) and hypothesis.inliers.any():
        return hypothesis.inliers
    bound_m = state.config.coarse.noise_bound_m if state.config is not None else 0.0
    moved_m = hypothesis.T_target_source.apply(matches.source_points_m)
    return np.asarray(np.linalg.norm(moved_m - matches.target_points_m, axis=1) <= bound_m)


def match_lines(matches: Correspondences, chosen: BoolArray, pose: RigidTransform, limit: int) -> FloatArray:
    """Return lines (K, 2, 3) of at most `limit` chosen matches, from target points to source points at a pose."""
    rows = np.flatnonzero(chosen)
    rows = rows[sample_indices(len(rows), limit)]
    return np.stack([matches.target_points_m[rows], pose.apply(matches.source_points_m[rows])], axis=1)
