# SPDX-License-Identifier: Apache-2.0
"""Parameters of descriptors and matches."""

from pydantic import Field

from multilica.config.section import Count, Positive, PositiveMetres, Section

__all__ = ["CorrespondConfig", "FeaturesConfig"]


class FeaturesConfig(Section):
    """FPFH descriptors."""

    voxel_size_m: PositiveMetres = Field(0.35, description="voxel grid on which descriptors are computed")
    further_voxel_sizes_m: tuple[PositiveMetres, ...] = Field(
        (0.5, 0.25),
        description="voxel grids of further searches between LiDARs that no accepted pair connects, one after another",
    )
    normal_radius_voxels: Positive = Field(2.0, description="neighbourhood of a normal, in voxels")
    normal_neighbours: Count = Field(30, description="largest number of neighbours of a normal")
    feature_radius_voxels: Positive = Field(5.0, description="neighbourhood of a descriptor, in voxels")
    feature_neighbours: Count = Field(100, description="largest number of neighbours of a descriptor")
    max_range_m: PositiveMetres = Field(40.0, description="farther returns get no descriptor")
    orient_normals: bool = Field(default=True, description="orient normals towards the sensor that saw the surface")


class CorrespondConfig(Section):
    """Matching of descriptors."""

    mutual: bool = Field(default=True, description="keep a match only if each is the other's nearest neighbour")
    max_keypoints: Count = Field(8000, description="descriptors per LiDAR that are matched; more are drawn evenly")
    max_matches: Count = Field(2000, description="the nearest matches that the coarse stage gets; bounds its memory")
