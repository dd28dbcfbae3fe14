# SPDX-License-Identifier: Apache-2.0
"""Parameters of the fine registration."""

from typing import Literal

from pydantic import Field

from multilica.config.section import Count, Positive, PositiveMetres, Section


class FineConfig(Section):
    """GICP of the finalists, and of the best of them on all points."""

    engine: Literal["small_gicp", "open3d"] = Field(
        "small_gicp",
        description="implementation of GICP; open3d: covariances follow from normals, and the voxel grid begins at the "
        "cloud, not at the sensor",
    )
    voxel_size_m: PositiveMetres = Field(
        0.15, description="voxel grid of GICP; on a finer grid, range noise tilts the normals and rotates the pose"
    )
    max_points: Count = Field(50_000, description="a cloud with more points is thinned on a coarser grid")
    max_correspondence_distances_m: tuple[PositiveMetres, ...] = Field(
        (0.5, 0.25), min_length=1, description="one GICP run each, from coarse to fine"
    )
    max_iterations: Count = Field(30, description="largest number of iterations of each run")
    rotation_epsilon_rad: Positive = Field(1e-4, description="converged when a step turns by less (small_gicp)")
    translation_epsilon_m: PositiveMetres = Field(1e-4, description="converged when a step moves by less (small_gicp)")
    gicp_epsilon: Positive = Field(0.005, description="variance along the normal; 1 across it (open3d)")
    relative_fitness: Positive = Field(1e-7, description="converged when fitness changes by less (open3d)")
    relative_rmse: Positive = Field(1e-7, description="converged when the RMSE changes by less (open3d)")
    neighbours: Count = Field(20, description="points from which a covariance or a normal is estimated")
    fitness_distance_m: PositiveMetres = Field(
        0.25, description="a point nearer than this to the other cloud is an inlier of fitness and RMSE"
    )
    max_finalists: Count = Field(
        6, description="distinct hypotheses per pair that are registered finely; the true one was always among four"
    )
    finalist_max_points: Count = Field(10_000, description="points per LiDAR with which finalists are compared")
