# SPDX-License-Identifier: Apache-2.0
"""Parameters of the search without an initial guess."""

from typing import Literal

from pydantic import Field

from multilica.config.section import Count, PositiveMetres, Section

__all__ = ["CoarseConfig"]


class CoarseConfig(Section):
    """Hypotheses from matches."""

    solver: Literal["cliques", "kiss_matcher", "teaserpp", "ransac", "fgr"] = Field(
        "cliques", description="cliques: the built-in solver after TEASER++"
    )
    noise_bound_m: PositiveMetres = Field(0.35, description="largest error of a correct match; about one voxel")
    max_hypotheses: Count = Field(24, description="largest number of distinct hypotheses per pair")
    normal_tolerance_deg: float = Field(
        25.0,
        gt=0.0,
        le=180.0,
        description="largest difference between angles of normals within a clique; 180: normals are ignored",
    )
