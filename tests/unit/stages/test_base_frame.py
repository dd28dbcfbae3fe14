# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from multilica.config import CalibrationConfig
from multilica.errors import UnknownNameError, UsageError
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.snapshot import LidarScans, Scan, Snapshot
from multilica.stages.known_poses import known_in_base, require_usable_rig

ROOT = RigidTransform.from_xyz_rpy("root", "base_link", [1.0, 0.0, 0.0], [0.0, 0.0, 0.5])
TOP = RigidTransform.from_xyz_rpy("root", "top_link", [0.0, 2.0, 1.0], [0.1, 0.0, 0.0])
RIG = Extrinsics("root", {"base_link": ROOT, "top_link": TOP})


def _lidar(name, frame_id=""):
    return LidarScans(name, (Scan(np.ones((1, 3), np.float32)),), frame_id=frame_id)


def _config(target=""):
    return CalibrationConfig(target=target, ground={"frame": "base_link"})


def test_a_lidar_is_known_by_its_name_or_frame_id():
    expected = (ROOT.inverse() @ TOP).matrix
    for lidar in (_lidar("top_link"), _lidar("top", "/top_link")):
        found = known_in_base(RIG, "base_link", lidar)
        assert (found.target, found.source) == ("base_link", lidar.name)
        np.testing.assert_allclose(found.matrix, expected)
    assert known_in_base(RIG, "base_link", _lidar("top")) is None


def test_a_rig_needs_the_base_frame_and_each_possible_target():
    snapshot = Snapshot((_lidar("left"), _lidar("top", "top_link")))
    require_usable_rig(RIG, snapshot, _config("top"))
    with pytest.raises(UsageError, match="'left', which may become the target; give --target, one of top"):
        require_usable_rig(RIG, snapshot, _config())
    with pytest.raises(UsageError, match="none of the LiDARs"):
        require_usable_rig(RIG, Snapshot((_lidar("left"),)), _config())
    with pytest.raises(UnknownNameError, match="axle"):
        require_usable_rig(RIG, snapshot, CalibrationConfig(ground={"frame": "axle"}))
