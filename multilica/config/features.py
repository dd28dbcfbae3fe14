# SPDX-License-Identifier: Apache-2.0
"""Parameters of descriptors and matches."""

from typing import Literal

from pydantic import Field

from multilica.config.section import Count, Positive, PositiveMetres, Section


class FeaturesConfig(Section):
    """FPFH descriptors."""

    engine: Literal["numpy", "open3d"] = Field(
        "numpy",
        description="implementation of FPFH; open3d: slower, and its voxel grid begins at the cloud, not at the sensor",
    )
    voxel_size_m: PositiveMetres = Field(0.35, description="voxel grid on which descriptors are computed")
    retry_voxel_sizes_m: tuple[PositiveMetres, ...] = Field(
        (0.5, 0.25),
        description="voxel grids of further searches between LiDARs that no accepted pair connects, one after another",
    )
    normal_radius_voxels: Positive = Field(2.0, le=10.0, description="neighbourhood of a normal, in voxels")
    normal_neighbours: Count = Field(30, description="largest number of neighbours of a normal")
    feature_radius_voxels: Positive = Field(5.0, le=10.0, description="neighbourhood of a descriptor, in voxels")
    feature_neighbours: Count = Field(100, description="largest number of neighbours of a descriptor")
    max_range_m: PositiveMetres = Field(40.0, description="farther returns get no descriptor")
    range_shape: Literal["sphere", "box"] = Field(
        "sphere", description="shape of the crop at max_range_m; box: limits each coordinate in the LiDAR's frame"
    )
    orient_normals: bool = Field(default=True, description="orient normals towards the sensor that saw the surface")


class CorrespondConfig(Section):
    """Matching of descriptors."""

    mutual: bool = Field(default=True, description="keep a match only if each is the other's nearest neighbour")
    engine: Literal["brute_force", "kd_tree"] = Field(
        "brute_force",
        description="nearest-neighbour search; brute_force: in single precision; kd_tree: in double precision",
    )
    max_keypoints: int = Field(
        8000, ge=0, description="descriptors per LiDAR that are matched; more are drawn evenly; 0: all"
    )
    max_matches: int = Field(
        2000,
        ge=0,
        description="nearest matches for the coarse stage, which limit its memory; 0: all, in the order of the "
        "source's points",
    )
