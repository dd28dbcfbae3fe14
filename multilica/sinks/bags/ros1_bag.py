# SPDX-License-Identifier: Apache-2.0
"""Writer of point clouds as a ROS 1 bag."""

import os
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

from rosbags.interfaces import Connection
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from multilica.pointcloud2 import encode_points
from multilica.sinks.bags.frames import frames_in_order, topic_of
from multilica.snapshot import Scan, Snapshot

_POINT_CLOUD = "sensor_msgs/msg/PointCloud2"


def write_ros1_bag(snapshot: Snapshot, path: Path) -> None:
    """Write the point clouds alone: names of LiDARs are frame ids, and there are no static transforms."""
    begun = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    begun.unlink(missing_ok=True)
    connections: dict[str, Connection] = {}
    try:
        with Writer(begun) as writer:
            for lidar, scan in frames_in_order(snapshot):
                topic = topic_of(lidar)
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, _POINT_CLOUD, typestore=_store())
                cloud = _cloud(lidar.frame_id, scan)
                writer.write(connections[topic], scan.stamp_ns, _store().serialize_ros1(cloud, _POINT_CLOUD))
        begun.replace(path)
    finally:
        begun.unlink(missing_ok=True)


@cache
def _store() -> Typestore:
    return get_typestore(Stores.ROS1_NOETIC)


def _cloud(frame_id: str, scan: Scan) -> Any:  # noqa: ANN401 - the classes are made by rosbags at run time
    types, packed = _store().types, encode_points(scan.points_m, scan.intensity)
    seconds, nanoseconds = divmod(scan.stamp_ns, 10**9)
    stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    return types[_POINT_CLOUD](
        header=types["std_msgs/msg/Header"](seq=0, stamp=stamp, frame_id=frame_id),
        height=packed.height,
        width=packed.width,
        fields=[types["sensor_msgs/msg/PointField"](**asdict(field)) for field in packed.fields],
        is_bigendian=packed.big_endian,
        point_step=packed.point_step,
        row_step=packed.row_step,
        data=packed.data,
        is_dense=True,
    )
