# SPDX-License-Identifier: Apache-2.0
"""Parameters of accepting a registration."""

from pydantic import Field

from multilica.config.section import NotNegative, Positive, PositiveMetres, Section


class AcceptanceConfig(Section):
    """Limits that a registration has to keep, alone and against competing poses."""

    min_evidence: float = Field(
        2.3, description="log-odds that a pose needs to count as the true one: 10 to 1; see docs/concepts.md"
    )
    min_log_odds_margin: Positive = Field(
        4.6, description="log-odds that it needs against every other pose, and against the rig as a whole: 100 to 1"
    )
    max_sigma_m: PositiveMetres = Field(
        0.02, description="largest standard deviation of a position; a pose above it is uncertain"
    )
    max_sigma_deg: Positive = Field(0.2, description="as max_sigma_m, for rotation: 3.5 cm at a distance of 10 m")
    max_baseline_m: PositiveMetres = Field(
        15.0, description="largest distance between two LiDARs of one vehicle; every stage drops poses beyond it"
    )
    perturbation_m: PositiveMetres = Field(
        0.3, description="perturbation along the weakest direction; rotations count as arcs at 10 m"
    )
    max_perturbed_offset_m: PositiveMetres = Field(
        0.15,
        description="a pose slides if a perturbed or thinned registration ends farther away; half of perturbation_m",
    )
    min_well_constrained_eigenvalue: NotNegative = Field(
        8.0,
        description="a pose is well constrained if the smallest eigenvalue of its information (points, 10 m arm) "
        "reaches this; for others more poses are tested",
    )
