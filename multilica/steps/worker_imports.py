# SPDX-License-Identifier: Apache-2.0
"""What tasks use, imported once for all worker processes."""

from multilica.registration.lazy_open3d import o3d
from multilica.steps import clouds, pairs

__all__ = ["clouds", "pairs"]

_LOADED = o3d.geometry.PointCloud
