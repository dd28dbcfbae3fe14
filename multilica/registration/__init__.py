# SPDX-License-Identifier: Apache-2.0
"""Registration of point clouds: GICP, plane fit, normals, neighbours."""
