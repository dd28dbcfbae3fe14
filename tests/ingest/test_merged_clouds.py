# SPDX-License-Identifier: Apache-2.0
"""Clouds that a node joined from those of several LiDARs are no LiDAR."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from multilica.config import IngestConfig
from multilica.geometry import RigidTransform
from multilica.ingest import inspect_source, read_snapshot
from multilica.ingest.merged_clouds import merged_topics
from multilica.ingest.message_types import Cloud
from multilica.snapshot import LidarScans, Scan, Snapshot
from tests.ingest.support.recording_writers import make_snapshot, write_mcap

SAMPLE = Path(__file__).parents[2] / "recordings" / "samples" / "edgar-street.mcap"
JOINED = "/sensing/concatenated/pointcloud"


@pytest.fixture(scope="module")
def rig() -> Snapshot:
    return read_snapshot(SAMPLE)


def moved(index: int) -> RigidTransform:
    return RigidTransform.from_xyz_rpy("base", "lidar", [1.5 * index, -0.6, 1.9], [0.01, 0.02, 0.4 * index])


def joined(lidars: tuple[LidarScans, ...], *, thinned: int = 1, first: int = 0) -> LidarScans:
    """The clouds of all LiDARs in one frame, without the points near the vehicle."""
    scans = []
    for frame, scan in enumerate(lidars[0].scans):
        parts = [moved(index + first).apply(lidar.scans[frame].points_m) for index, lidar in enumerate(lidars)]
        points_m = np.concatenate(parts)[::thinned].astype(np.float32)
        points_m = points_m[np.linalg.norm(points_m, axis=1) > 3.0]
        scans.append(Scan(points_m, scan.stamp_ns, np.zeros(len(points_m), np.float32)))
    return LidarScans("joined", tuple(scans), "base_link", JOINED)


def clouds_of(*lidars: LidarScans) -> dict[str, list[Cloud]]:
    return {lidar.topic: [Cloud(scan) for scan in lidar.scans] for lidar in lidars}


def written(path: Path, *lidars: LidarScans) -> Path:
    with_intensity = [
        replace(
            each,
            scans=tuple(replace(scan, intensity=np.zeros(len(scan.points_m), np.float32)) for scan in each.scans),
        )
        for each in lidars
    ]
    write_mcap(Snapshot(tuple(with_intensity)), path, chunk_size=1 << 20)
    return path


def test_a_cloud_of_all_lidars_is_left_out(tmp_path: Path) -> None:
    lidars = make_snapshot(lidars=3, points=400).lidars
    path = written(tmp_path / "a.mcap", *lidars, joined(lidars))
    snapshot = read_snapshot(path)
    assert snapshot.names == tuple(lidar.name for lidar in lidars)
    (note,) = snapshot.notes
    assert note.startswith(f"'{JOINED}' holds the points of /lidar_0/points, /lidar_1/points, /lidar_2/points, moved")
    assert [cloud.topic for cloud in inspect_source(path).clouds if not cloud.lidar] == [JOINED]
    chosen = read_snapshot(path, config=IngestConfig(only=(JOINED, "/lidar_0/points")))
    assert chosen.names == ("base_link", "lidar_0")
    assert "its pose will be of these" in chosen.notes[0]


def test_thinned_clouds_are_told_by_their_name(tmp_path: Path) -> None:
    lidars = make_snapshot(points=400).lidars
    snapshot = read_snapshot(written(tmp_path / "a.mcap", *lidars, joined(lidars, thinned=3)))
    assert "base_link" in snapshot.names
    (note,) = snapshot.notes
    assert note.startswith(f"'{JOINED}' is named like clouds joined from several LiDARs; leave it out with --topic")


def test_real_clouds_joined_in_the_frame_of_one(rig: Snapshot) -> None:
    lidars = rig.lidars
    assert merged_topics(clouds_of(*lidars)) == {}
    others = [lidar.topic for lidar in lidars]
    assert merged_topics(clouds_of(*lidars, joined(lidars))) == {JOINED: others}
    own_frame = joined(lidars)
    scans = tuple(replace(s, points_m=moved(0).inverse().apply(s.points_m).astype(np.float32)) for s in own_frame.scans)
    assert JOINED in merged_topics(clouds_of(*lidars, replace(own_frame, scans=scans)))


def test_parts_that_were_moved_apart_are_no_rigid_copy(rig: Snapshot) -> None:
    """From one point to the next, all distances but one are as before."""
    points_m = rig.lidars[0].scans[0].points_m
    halves = [moved(index).apply(half) for index, half in enumerate(np.array_split(points_m, 2))]
    for parts, held in ((halves, {}), ((moved(1).apply(points_m),), {"/joined": ["/one"]})):
        longer_m = np.concatenate([*parts, parts[0]]).astype(np.float32)
        clouds = {"/one": [Cloud(Scan(points_m))], "/joined": [Cloud(Scan(longer_m))]}
        assert merged_topics(clouds) == held


def test_a_part_of_a_cloud_makes_the_whole_no_joined_one(rig: Snapshot) -> None:
    first = rig.lidars[0]
    near = tuple(
        Scan(scan.points_m[np.linalg.norm(scan.points_m, axis=1) < 15.0], scan.stamp_ns) for scan in first.scans
    )
    assert merged_topics(clouds_of(*rig.lidars, replace(first, scans=near, topic="/near"))) == {}


def test_regular_clouds_without_noise_are_not_taken_for_joined() -> None:
    """Two LiDARs of one model at one height over flat ground measure the same steps from point to point."""
    angle, distance_m = np.meshgrid(np.linspace(0.0, 2 * np.pi, 900, endpoint=False), np.geomspace(3.0, 60.0, 32))
    flat = [angle, np.cos(angle) * distance_m, np.sin(angle) * distance_m, np.full(angle.shape, -1.8)]
    points_m = np.stack([axis.T.ravel() for axis in flat[1:]], axis=1).astype(np.float32)
    wall = points_m[(points_m[:, 0] < 8.0) & (points_m[:, 1] < 20.0)]
    frames = {name: LidarScans(name, (Scan(cloud, 0),), topic=name) for name, cloud in (("a", points_m), ("b", wall))}
    assert merged_topics(clouds_of(*frames.values())) == {}


def test_few_points_and_empty_clouds_are_no_joined_ones() -> None:
    scans = [Scan(np.zeros((count, 3), np.float32), 0) for count in (0, 5, 300)]
    lidars = [LidarScans(f"l{index}", (scan,), topic=f"/l{index}") for index, scan in enumerate(scans)]
    assert merged_topics(clouds_of(*lidars)) == {}
