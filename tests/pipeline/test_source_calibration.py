# SPDX-License-Identifier: Apache-2.0
"""`multilica.calibrate` of recordings and of snapshots."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import multilica
from multilica.errors import SourceNotFoundError, UnfitSnapshotError, UsageError
from multilica_cli.commands.calibrate import find_sample
from tests.cli.support import write_pcd

CONFIG = multilica.preset("default").model_copy(
    update={
        "ingest": multilica.CalibrationConfig().ingest.model_copy(
            update={"only": ("/lidar/front/*", "/lidar/left/*"), "frames": 1}
        )
    }
)


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_path_a_list_and_a_snapshot_are_the_same() -> None:
    sample = find_sample().recording
    snapshot = multilica.read_snapshot(sample, config=CONFIG.ingest)
    poses = [
        multilica.calibrate(source, CONFIG)["front"].T_target_source for source in (snapshot, str(sample), [sample])
    ]
    assert [pose.matrix.tobytes() for pose in poses] == [poses[0].matrix.tobytes()] * 3
    metres, radians = multilica.read_extrinsics(str(find_sample().truth)).between("left", "front").distance_to(poses[0])
    assert (metres, np.rad2deg(radians)) <= (0.02, 0.1)


def test_a_source_that_is_not_there_is_told() -> None:
    with pytest.raises(SourceNotFoundError, match="nowhere"):
        multilica.calibrate("nowhere.mcap")


def test_one_lidar_is_told_with_the_name_of_the_file(tmp_path: Path) -> None:
    with pytest.raises(UnfitSnapshotError, match=r"alone\.pcd has only one LiDAR"):
        multilica.calibrate(write_pcd(tmp_path / "alone.pcd", [[1.0, 2.0, 3.0]]))


def test_recordings_of_the_same_lidars_are_refused() -> None:
    with pytest.raises(UsageError):
        multilica.calibrate([find_sample().recording] * 2)


def test_several_snapshots_take_no_prior_and_no_paths() -> None:
    lidar = multilica.LidarScans("a", (multilica.Scan(np.ones((5, 3), np.float32)),))
    snapshot = multilica.Snapshot((lidar,))
    prior = multilica.Extrinsics("a", {})
    with pytest.raises(UsageError, match="2 were given"):
        multilica.calibrate([snapshot, snapshot], prior=prior)
    with pytest.raises(UsageError, match="found both"):
        multilica.calibrate([snapshot, "drive.mcap"])  # type: ignore[list-item]
