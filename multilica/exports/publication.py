# SPDX-License-Identifier: Apache-2.0
"""A saved run as messages of ROS 2: its transforms, and the clouds of all LiDARs in one frame."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from multilica.exports.files import FrameNames, rig_of_run
from multilica.exports.stitched_cloud import read_stitched_cloud
from multilica.pointcloud2 import MERGED_TOPIC
from multilica.runs.run_documents import read_run_document
from multilica.sinks.mcap import ros2_types
from multilica.sinks.mcap.messages import McapMessage

TRANSFORMS_TOPIC = "/tf_static"


@dataclass(frozen=True, slots=True, eq=False)
class Publication:
    """Messages, a latched one per topic.

    Args:
        base: the frame that the poses and the cloud are in.
        lidars: those with a pose.
        missing: LiDAR -> status, for those without.
    """

    messages: tuple[McapMessage, ...]
    base: str
    lidars: tuple[str, ...]
    missing: Mapping[str, str]


def publication_of(
    run: Path,
    *,
    base: str | None = None,
    rig: Path | None = None,
    frames: FrameNames = "ids",
    with_uncertain: bool = False,
) -> Publication:
    """Read what is published of a run; see `rig_of_run` for the arguments.

    Raises:
        MultilicaError: as `rig_of_run` and `read_stitched_cloud`.
    """
    document = read_run_document(run).document
    found, frame_of = rig_of_run(document, base=base, rig=rig, frames=frames, with_uncertain=with_uncertain)
    poses = {lidar: found.between(found.target, frame) for lidar, frame in frame_of.items()}
    cloud = read_stitched_cloud(run, poses, tuple(document.lidars))
    now_ns = time.time_ns()
    transforms = ros2_types.transforms(
        [found.T_target_source[frame] for frame in sorted(found.T_target_source)], now_ns
    )
    points_m = np.ascontiguousarray(cloud["xyz"], dtype=np.float32)
    points = ros2_types.point_cloud(found.target, now_ns, points_m)
    messages = tuple(
        McapMessage(
            topic,
            ros2_types.schema_of(message.__msgtype__),
            ros2_types.serialised(message),
            ros2_types.offered_qos(latched=True),
        )
        for topic, message in ((TRANSFORMS_TOPIC, transforms), (MERGED_TOPIC, points))
    )
    missing = {name: entry.status for name, entry in document.lidars.items() if name not in frame_of}
    return Publication(messages, found.target, tuple(frame_of), missing)
