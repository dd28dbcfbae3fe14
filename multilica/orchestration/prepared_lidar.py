# SPDX-License-Identifier: Apache-2.0
"""A LiDAR prepared for the stages that work on pairs."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from multilica.config import CalibrationConfig
from multilica.registration.gicp_cloud import prepare_gicp_cloud
from multilica.results import FeatureCloud, PreprocessedCloud
from multilica.stages.features import compute_features
from multilica.stages.fine import RegistrationCloud, prepare_registration_cloud
from multilica.stages.verify import VerificationCloud, short_gicp
from multilica.visibility.sensor_view import SensorView, prepare_sensor_view

_NO_POINTS = np.empty((0, 3))


@dataclass(frozen=True, eq=False)
class PreparedLidar:
    """Data that all searches and registrations of one LiDAR share; clouds for GICP are built on first use.

    Args:
        cloud: its points; the returns are left out.
        features: descriptors on the usual voxel grid.
        view: None where verification is off.
    """

    cloud: PreprocessedCloud
    features: FeatureCloud
    view: SensorView | None
    config: CalibrationConfig
    _features: dict[float, FeatureCloud] = field(default_factory=dict)

    def features_at(self, voxel_size_m: float) -> FeatureCloud:
        """Return the descriptors on a voxel grid of that size."""
        usual = self.config.features
        if voxel_size_m == usual.voxel_size_m:
            return self.features
        if voxel_size_m not in self._features:
            of_size = usual.model_copy(update={"voxel_size_m": voxel_size_m})
            self._features[voxel_size_m] = compute_features(self.cloud, of_size)
        return self._features[voxel_size_m]

    @cached_property
    def verification_cloud(self) -> VerificationCloud:
        """The LiDAR as one side of a short GICP; only where verification is on."""
        assert self.view is not None  # noqa: S101
        gicp = short_gicp(self.config.fine)
        return VerificationCloud(self.view, prepare_gicp_cloud(self.cloud.lidar, self.cloud.points_m, gicp))

    @cached_property
    def side(self) -> RegistrationCloud:
        """The LiDAR as one side of a fine registration."""
        views = [] if self.view is None else self.view.alone
        return prepare_registration_cloud(self.cloud.lidar, self.cloud.points_m, views, self.config)

    def __reduce__(self) -> tuple[object, ...]:
        """Leave out what is built on first use: types of the engines cannot be copied to another process."""
        return PreparedLidar, (self.cloud, self.features, self.view, self.config)


def prepare_lidar(cloud: PreprocessedCloud, config: CalibrationConfig, *, described: bool = True) -> PreparedLidar:
    """Compute the descriptors of a LiDAR, if they are wanted, and its view if verification is on."""
    features = compute_features(cloud if described else replace(cloud, points_m=_NO_POINTS), config.features)
    view = prepare_sensor_view(cloud) if config.verify.enabled else None
    slim = replace(cloud, returns_m=np.empty((0, 3), np.float32), dropped_m={}, left_out=cloud.returns)
    return PreparedLidar(slim, features, view, config)
