# SPDX-License-Identifier: Apache-2.0
"""One side of a fine registration, prepared for GICP."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from multilica.config import CalibrationConfig, FineConfig
from multilica.geometry import Z_AXIS, FloatArray
from multilica.registration.gicp import SHORT_ITERATIONS, GicpCloud, prepare_gicp_cloud
from multilica.visibility.sensor_view import PlacedView

# Points per LiDAR with which finalists are compared.
_FINALIST_POINTS = 10_000


@dataclass(frozen=True, eq=False)
class RegistrationCloud:
    """One side of a registration: a LiDAR, or a group with known poses.

    Args:
        cloud: the points of all members in the frame of the LiDAR or of the group's root.
        views: the members with their poses; empty where verification is off.
        finalist_gicp: how `thinned` is prepared and registered.
    """

    cloud: GicpCloud
    views: tuple[PlacedView, ...]
    finalist_gicp: FineConfig

    @cached_property
    def thinned(self) -> GicpCloud:
        """The cloud with fewer points, enough to compare finalists."""
        if len(self.cloud.points_m) <= self.finalist_gicp.max_points:
            return self.cloud
        cloud = self.cloud
        return prepare_gicp_cloud(cloud.name, cloud.points_m, self.finalist_gicp, cloud.elevation_axis)


def prepare_registration_cloud(
    name: str,
    points_m: FloatArray,
    views: Sequence[PlacedView],
    config: CalibrationConfig,
    elevation_axis: FloatArray = Z_AXIS,
) -> RegistrationCloud:
    """Prepare the points (N, 3) of a LiDAR or a group, given in the frame of that name, for GICP."""
    fine = config.fine
    cloud = prepare_gicp_cloud(name, points_m, fine, elevation_axis)
    iterations = min(SHORT_ITERATIONS, fine.max_iterations)
    finalist_gicp = fine.model_copy(update={"max_points": _FINALIST_POINTS, "max_iterations": iterations})
    return RegistrationCloud(cloud, tuple(views), finalist_gicp)
