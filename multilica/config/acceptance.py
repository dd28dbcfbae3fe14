# SPDX-License-Identifier: Apache-2.0
"""Parameters of accepting a registration."""

from pydantic import Field

from multilica.config.section import Count, Metres, Positive, PositiveMetres, Section, Share

__all__ = ["AcceptanceConfig"]


class AcceptanceConfig(Section):
    """Limits that a registration has to keep, alone and against competing poses."""

    min_agreeing_points: Count = Field(100, description="points on common surfaces that a pose needs")
    min_evidence: Metres = Field(
        30.0, description="evidence that a pose needs: points that agree off the commonest plane, less violations"
    )
    max_violation_share: Share = Field(
        0.002, description="largest share of points in proven-empty space: foliage, glass and moving things cause some"
    )
    max_violation_share_firm: Share = Field(0.004, description="as max_violation_share, for a firm pose")
    min_explained_share: Share = Field(
        0.5, description="share of the structure in view of both that must lie on measured surfaces"
    )
    min_explained_share_firm: Share = Field(0.1, description="as min_explained_share, for a firm pose")
    firm_eigenvalue: Metres = Field(
        8.0, description="a pose is firm if the smallest eigenvalue of its information (points, 10 m arm) reaches this"
    )
    max_competing_share: Share = Field(0.7, description="largest share of the evidence that a competing pose may have")
    max_standing_share: Share = Field(
        0.25, description="as max_competing_share, for a competing pose that would be accepted by itself"
    )
    min_standing_explained: Share = Field(
        0.8, description="such a pose explains at least this share of what the best pose explains"
    )
    min_standing_eigenvalue: Metres = Field(
        0.12, description="smallest eigenvalue of the information that such a pose has at least"
    )
    hopeless_evidence: Positive = Field(
        300.0, description="a pose that is this far behind the best and has a small share of its evidence is dropped"
    )
    min_curvature: Metres = Field(
        0.2, description="smallest eigenvalue of the GICP Hessian per inlier, rotations as arcs at 10 m"
    )
    max_sigma_m: PositiveMetres = Field(0.02, description="largest standard deviation of the position")
    max_sigma_deg: Positive = Field(0.2, description="as max_sigma_m, for rotation: 3.5 cm at a distance of 10 m")
    max_baseline_m: PositiveMetres = Field(
        15.0, description="largest distance between two LiDARs of one vehicle; every stage drops poses beyond it"
    )
    max_baseline_loose_m: PositiveMetres = Field(
        5.0,
        description="as max_baseline_m, for a pose that is not firm: chance agreements are anywhere, cars are short",
    )
