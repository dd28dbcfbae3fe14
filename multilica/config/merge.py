# SPDX-License-Identifier: Apache-2.0
"""Parameters of joining pairs and snapshots to one rig."""

from typing import Literal

from pydantic import Field

from multilica.config.section import Count, Positive, PositiveMetres, Section, Share


class MergeConfig(Section):
    """Growth of the calibrated cloud."""

    mode: Literal["graph", "algorithm1", "target_first"] = Field(
        "graph",
        description="graph: accepted pairs join their LiDARs, groups are registered only if no such pair joins them; "
        "algorithm1: the best pair first, then the pairs of its LiDARs again, as in the paper; target_first: "
        "each LiDAR to the target, then the others to the merged cloud, as in the published code of the paper",
    )
    fitness_threshold: Share = Field(0.2, description="without verification, a pair needs a larger fitness")


class RefineConfig(Section):
    """Joint adjustment of all poses to all accepted pairs, with covariances."""

    enabled: bool = Field(default=True, description="off: poses stay as merged")
    distance_m: PositiveMetres = Field(0.2, description="points nearer than this to the other cloud constrain the pose")
    max_points: Count = Field(20_000, description="common points to which a pose is fitted; more are thinned evenly")
    min_sigma_m: PositiveMetres = Field(0.005, description="lower bound of the residuals")
    outlier_sigma: Positive = Field(3.0, description="a pair off by this many sigma keeps half its weight")
    max_iterations: Count = Field(20, description="Gauss-Newton steps")
    epsilon: Positive = Field(1e-9, description="converged when no pose moves by more (rad, m)")


class JointConfig(Section):
    """Several snapshots of one rig as one result."""

    max_disagreement_m: PositiveMetres = Field(
        0.05,
        description="snapshots contradict each other if they place a LiDAR farther apart, and by refine.outlier_sigma; "
        "correct poses differ by millimetres",
    )
    max_disagreement_deg: Positive = Field(0.5, description="as max_disagreement_m, for rotation: 9 cm at 10 m")
