# SPDX-License-Identifier: Apache-2.0
"""Writer of point clouds as an MCAP file of rosbag2."""

from collections.abc import Mapping
from pathlib import Path

from mcap.well_known import Profile
from mcap.writer import CompressionType, Writer

import multilica
from multilica.sinks.bags.frames import frames_in_order, topic_of
from multilica.sinks.files.atomic import atomic_file
from multilica.sinks.mcap import ros2_types as ros2
from multilica.sinks.mcap.messages import McapMessage, MessageWriter
from multilica.snapshot import Snapshot

_METADATA_NAME = "log"


def write_ros2_mcap(snapshot: Snapshot, path: Path, *, metadata: Mapping[str, str] | None = None) -> None:
    """Write the point clouds alone, in CDR: names of LiDARs are frame ids, and there are no static transforms.

    Args:
        metadata: entries of the metadata record ``log``, for instance `vehicle`.
    """
    with atomic_file(path) as file:
        writer = Writer(file, compression=CompressionType.ZSTD, enable_data_crcs=True)
        writer.start(profile=Profile.ROS2, library=f"multilica {multilica.__version__}")
        messages, schema = MessageWriter(writer), ros2.schema_of(ros2.POINT_CLOUD)
        for lidar, scan in frames_in_order(snapshot):
            cloud = ros2.point_cloud(lidar.frame_id, scan.stamp_ns, scan.points_m, scan.intensity)
            channel = ros2.offered_qos(latched=False)
            messages.write(McapMessage(topic_of(lidar), schema, ros2.serialised(cloud), channel), scan.stamp_ns)
        if metadata:
            writer.add_metadata(_METADATA_NAME, dict(metadata))
        writer.finish()  # type: ignore[no-untyped-call]
