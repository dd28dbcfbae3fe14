# SPDX-License-Identifier: Apache-2.0
"""Which matches a pose keeps."""

from __future__ import annotations

import numpy as np

from multilica.results import BoolArray, Correspondences, Hypothesis
from multilica.sinks.run_story import RunStory

__all__ = ["kept_matches"]


def kept_matches(story: RunStory, matches: Correspondences, hypothesis: Hypothesis) -> BoolArray:
    """(M,) which matches agree with the hypothesis, by distance where the solver does not tell."""
    if len(hypothesis.inliers) == len(matches) and hypothesis.inliers.any():
        return hypothesis.inliers
    bound_m = story.config.coarse.noise_bound_m if story.config is not None else 0.0
    moved_m = hypothesis.T_target_source.apply(matches.source_points_m)
    return np.asarray(np.linalg.norm(moved_m - matches.target_points_m, axis=1) <= bound_m)
