# SPDX-License-Identifier: Apache-2.0
"""Parameters of testing hypotheses by what the beams prove."""

from pydantic import Field

from multilica.config.section import Count, Positive, PositiveMetres, Section


class VisibilityConfig(Section):
    """Scoring of a pose by free space: which points are tested, how near counts as equal."""

    max_range_m: PositiveMetres = Field(50.0, description="points beyond are left out")
    probe_voxel_size_m: PositiveMetres = Field(0.5, description="voxel grid of the points that are tested")
    tolerance_m: PositiveMetres = Field(0.15, description="a point nearer than this to a measured surface lies on it")
    tolerance_deg: Positive = Field(0.5, description="growth of that tolerance with range: the rotation's error")
    fine_tolerance_m: PositiveMetres = Field(0.08, description="as tolerance_m, after the fine registration")
    fine_tolerance_deg: Positive = Field(0.2, description="as tolerance_deg, after the fine registration")

    @property
    def rough_tolerances(self) -> tuple[float, float]:
        """Metres and degrees of `tolerance_m` and `tolerance_deg`."""
        return self.tolerance_m, self.tolerance_deg

    @property
    def fine_tolerances(self) -> tuple[float, float]:
        """The same after the fine registration."""
        return self.fine_tolerance_m, self.fine_tolerance_deg


class VerifyConfig(Section):
    """Short registration and ranking of the hypotheses, with poses that could be confused with the best."""

    enabled: bool = Field(
        default=True, description="off: the hypothesis with the most matches is taken, as in the paper"
    )
    voxel_size_m: PositiveMetres = Field(0.5, description="voxel grid of the short GICP that each hypothesis gets")
    max_points: Count = Field(4000, description="points per LiDAR of the short GICP; a denser cloud is thinned further")
    max_iterations: Count = Field(
        10, description="iterations of each run of the short GICP, and of a finalist that can no longer win"
    )
    early_stop_poses: Count = Field(6, ge=2, description="distinct poses after which the search may stop early")
    early_stop_poses_constrained: Count = Field(
        2, ge=2, description="as early_stop_poses, if the best is well constrained"
    )
    max_symmetric_poses: int = Field(6, ge=0, description="poses turned by right angles that are tested as well")
    slide_step_m: PositiveMetres = Field(
        1.0,
        description="step along the weakest direction at which poses are tested if the best is not well constrained "
        "or slides",
    )
    slide_steps: int = Field(6, ge=0, description="number of such steps to either side: repeating facades look alike")
