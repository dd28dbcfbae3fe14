# SPDX-License-Identifier: Apache-2.0
"""The simplest peer: KISS-Matcher of each LiDAR against the target, then small_gicp, as a program of its own.

It reads an MCAP of PointCloud2 messages, or a folder with a compressed PCD file per LiDAR, and prints each LiDAR's pose
in the target's frame as a line of JSON. It judges nothing and writes no file.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import kiss_matcher
import numpy as np
import small_gicp

# The libraries' own defaults.
VOXEL_M, GICP_VOXEL_M = 0.3, 0.25


def main(source: str, target: str) -> None:
    """Print the pose of each LiDAR but the target."""
    clouds = read_mcap(source) if source.endswith(".mcap") else read_folder(source)
    for name, pose in place(clouds, target).items():
        print(json.dumps({"lidar": name, "T_target_source": pose.tolist()}))


def place(clouds: dict[str, np.ndarray], target: str) -> dict[str, np.ndarray]:
    """Return ``T_target_source`` (4, 4) of each LiDAR but the target, from points (N, 3) per LiDAR."""
    coarse = {name: small_gicp.voxelgrid_sampling(points, VOXEL_M).points()[:, :3] for name, points in clouds.items()}
    fine = {name: small_gicp.preprocess_points(points, GICP_VOXEL_M) for name, points in clouds.items()}
    target_cloud, target_tree = fine[target]
    poses = {}
    for name in sorted(clouds.keys() - {target}):
        matcher = kiss_matcher.KISSMatcher(kiss_matcher.KISSMatcherConfig(VOXEL_M))
        found = matcher.estimate(coarse[name].astype(np.float32), coarse[target].astype(np.float32))
        start = np.eye(4)
        start[:3, :3], start[:3, 3] = found.rotation, found.translation
        poses[name] = small_gicp.align(target_cloud, fine[name][0], target_tree, start).T_target_source
    return poses


def read_mcap(path: str) -> dict[str, np.ndarray]:
    """Return per LiDAR the points (N, 3) of all its messages, which are named after their frame."""
    from mcap_ros2.reader import read_ros2_messages

    frames: dict[str, list[np.ndarray]] = {}
    for message in read_ros2_messages(path):
        cloud = message.ros_msg
        if message.schema.name != "sensor_msgs/msg/PointCloud2":
            continue
        rows = np.frombuffer(cloud.data, np.uint8).reshape(-1, cloud.point_step)
        starts = [field.offset for axis in "xyz" for field in cloud.fields if field.name == axis]
        points = np.hstack([rows[:, start : start + 4] for start in starts]).view("<f4")
        frames.setdefault(cloud.header.frame_id, []).append(points[np.isfinite(points).all(axis=1)])
    return {name: np.concatenate(parts).astype(np.float64) for name, parts in frames.items()}


def read_folder(path: str) -> dict[str, np.ndarray]:
    """Return per LiDAR the points (N, 3) of its file of compressed PCD."""
    return {file.stem: read_pcd(file) for file in sorted(Path(path).glob("*.pcd"))}


def read_pcd(path: Path) -> np.ndarray:
    """Return the points (N, 3) of a compressed PCD file that begins with x, y and z as 32-bit floats."""
    import lzf

    head, body = path.read_bytes().split(b"DATA binary_compressed\n", 1)
    count = int(head.split(b"\nPOINTS ", 1)[1].split()[0])
    packed, size = np.frombuffer(body, "<u4", 2).tolist()
    columns = lzf.decompress(body[8 : 8 + packed], size)
    return np.frombuffer(columns, "<f4", 3 * count).reshape(3, count).T.astype(np.float64)


if __name__ == "__main__":
    main(*sys.argv[1:])
