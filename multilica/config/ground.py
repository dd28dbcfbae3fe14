# SPDX-License-Identifier: Apache-2.0
"""Parameters of the ground plane."""

from pydantic import Field

from multilica.config.section import Count, PositiveMetres, Section


class GroundConfig(Section):
    """The plane under the vehicle."""

    enabled: bool = Field(default=False, description="estimate roll, pitch and z of the base frame")
    frame: str = Field("base", min_length=1, description="name of the base frame")
    max_range_m: PositiveMetres = Field(20.0, description="only points nearer than this to the rig's middle are used")
    distance_m: PositiveMetres = Field(0.05, description="a point nearer than this to the ground belongs to it")
    iterations: Count = Field(1000, description="RANSAC draws")
    max_tilt_deg: float = Field(
        60.0, gt=0.0, le=90.0, description="largest tilt of the ground against the target's z axis"
    )
