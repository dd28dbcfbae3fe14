# SPDX-License-Identifier: Apache-2.0
"""Parameters of cleaning the returns."""

from pydantic import Field

from multilica.config.section import Metres, Positive, PositiveMetres, Section, Share


class StillnessConfig(Section):
    """Detection of moving objects and of a moving vehicle."""

    enabled: bool = Field(default=True, description="drop points that move; refuse the snapshot of a moving vehicle")
    moving_clearance_m: PositiveMetres = Field(
        0.2,
        description="a return has moved if beams of another frame pass this far behind it; ten times the range noise",
    )
    max_shift_m: PositiveMetres = Field(
        0.05, description="largest shift of a LiDAR between its first and last frame; twice the range noise"
    )
    max_rotation_deg: Positive = Field(0.3, description="as max_shift_m, for rotation: 5 cm at a distance of 10 m")


class PreprocessConfig(Section):
    """Range limits and thinning of the returns."""

    min_range_m: Metres = Field(1.0, description="nearer returns are dropped: the vehicle's own body")
    max_range_m: PositiveMetres = Field(100.0, description="farther returns are dropped: too sparse to help")
    voxel_size_m: Metres = Field(0.05, description="voxel grid on which the clouds are thinned; 0: no thinning")


class HealthConfig(Section):
    """Detection of dirty sensors."""

    max_blockage_ratio: Share = Field(
        0.1, description="share of the field of view that may end in scattered echoes below preprocess.min_range_m"
    )
