# SPDX-License-Identifier: Apache-2.0
"""Writer of point clouds as a ROS 2 bag in SQLite."""

import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer

from multilica.sinks.bags.frames import frames_in_order, topic_of
from multilica.sinks.mcap import ros2_types as ros2
from multilica.snapshot import Snapshot

_VERSION: Final = 9


def write_ros2_bag(snapshot: Snapshot, folder: Path, *, custom_data: Mapping[str, str] | None = None) -> None:
    """Write the point clouds alone: names of LiDARs are frame ids, and there are no static transforms.

    The folder must not exist.

    Args:
        custom_data: entries of ``metadata.yaml``, for instance `vehicle`.
    """
    with _atomic_folder(folder) as begun:
        writer = Writer(begun, version=_VERSION, storage_plugin=StoragePlugin.SQLITE3)
        for key, value in (custom_data or {}).items():
            writer.set_custom_data(key, value)
        definition = ros2.schema_of(ros2.POINT_CLOUD).data.decode()
        connections: dict[str, Connection] = {}
        with writer:
            for lidar, scan in frames_in_order(snapshot):
                topic = topic_of(lidar)
                if topic not in connections:
                    connections[topic] = writer.add_connection(
                        topic, ros2.POINT_CLOUD, msgdef=definition, rihs01=ros2.hash_of(ros2.POINT_CLOUD)
                    )
                cloud = ros2.point_cloud(lidar.frame_id, scan.stamp_ns, scan.points_m, scan.intensity)
                writer.write(connections[topic], scan.stamp_ns, ros2.serialised(cloud))


@contextmanager
def _atomic_folder(folder: Path) -> Iterator[Path]:
    """Yield a folder of the same name elsewhere, which the block makes, and which is moved when the block ends."""
    begun = folder.with_name(f".{folder.name}.{os.getpid()}.tmp")
    shutil.rmtree(begun, ignore_errors=True)
    begun.mkdir(parents=True)
    try:
        yield begun / folder.name
        (begun / folder.name).rename(folder)
    finally:
        shutil.rmtree(begun, ignore_errors=True)
