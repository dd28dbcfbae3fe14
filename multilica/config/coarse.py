# SPDX-License-Identifier: Apache-2.0
"""Parameters of the search without an initial guess."""

from typing import Literal

from pydantic import Field

from multilica.config.section import Count, Positive, PositiveMetres, Section


class CoarseConfig(Section):
    """Hypotheses from matches."""

    solver: Literal["cliques", "maximum_clique", "teaserpp", "kiss_matcher"] = Field(
        "cliques",
        description="cliques: several hypotheses, by the idea of TEASER++; maximum_clique: TEASER++ itself; teaserpp: "
        "the same by teaserpp_python if it is installed",
    )
    noise_bound_m: PositiveMetres = Field(0.35, description="largest error of a correct match; about one voxel")
    max_hypotheses: Count = Field(24, description="largest number of distinct hypotheses per pair")
    normal_tolerance_deg: float = Field(
        25.0,
        gt=0.0,
        le=180.0,
        description="largest difference between angles of normals within a clique; 180: normals are ignored",
    )
    min_agreeing_matches: int = Field(3, ge=0, description="a hypothesis with fewer agreeing matches is dropped")
    cbar2: Positive = Field(1.0, description="factor of the squared noise bound (maximum_clique, teaserpp)")
    gnc_factor: float = Field(
        1.4, gt=1.0, description="growth of the sharpness of the cost per iteration (maximum_clique, teaserpp)"
    )
    gnc_max_iterations: Count = Field(
        10_000, description="iterations of the robust rotation (maximum_clique, teaserpp)"
    )
    gnc_cost_threshold: Positive = Field(
        1e-16, description="converged when the cost of the rotation changes by less, m^2 (maximum_clique, teaserpp)"
    )
