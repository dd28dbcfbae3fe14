# SPDX-License-Identifier: Apache-2.0
"""Thinning of clouds on a voxel grid."""

import numpy as np
import small_gicp

from multilica.geometry import FloatArray

__all__ = ["thin"]


def thin(points_m: FloatArray, voxel_size_m: float) -> FloatArray:
    """Replace the points (N, 3) of each voxel by their centroid; return all points if the size is 0.

    Always one thread: with more, voxels at the borders of the threads' shares are split.
    """
    if voxel_size_m == 0.0 or len(points_m) == 0:
        return points_m
    voxels = small_gicp.voxelgrid_sampling(points_m, voxel_size_m, num_threads=1)
    return np.ascontiguousarray(voxels.points()[:, :3])
