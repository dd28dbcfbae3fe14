# SPDX-License-Identifier: Apache-2.0
"""Thin a cloud on a regular grid."""

from __future__ import annotations

import numpy as np
import small_gicp

from multilica.geometry import FloatArray

__all__ = ["thin"]


def thin(points_m: FloatArray, voxel_size_m: float) -> FloatArray:
    """One point per occupied voxel, the centroid of its points (N, 3); all points if the size is 0.

    One thread always: with more, the voxels at the borders of the threads' shares are split.
    """
    if voxel_size_m == 0.0 or len(points_m) == 0:
        return points_m
    voxels = small_gicp.voxelgrid_sampling(points_m, voxel_size_m, num_threads=1)
    return np.ascontiguousarray(voxels.points()[:, :3])
