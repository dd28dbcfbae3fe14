# SPDX-License-Identifier: Apache-2.0
"""Writer of static transforms as an MCAP file for ROS tools."""

from collections.abc import Sequence
from io import BytesIO

from mcap.well_known import Profile
from mcap.writer import Writer

import multilica
from multilica.geometry import RigidTransform
from multilica.sinks.mcap import ros2_types as ros2
from multilica.sinks.mcap.messages import McapMessage, MessageWriter

_STAMP_NS = 10**9
"""Readers treat zero as unset; the time of a static transform has no meaning."""


def static_transforms_mcap(poses: Sequence[RigidTransform]) -> bytes:
    """Return a ROS 2 recording with one ``tf2_msgs/msg/TFMessage`` on `/tf_static`, latched for late subscribers."""
    file = BytesIO()
    writer = Writer(file, enable_data_crcs=True)
    writer.start(profile=Profile.ROS2, library=f"multilica {multilica.__version__}")
    schema, channel = ros2.schema_of(ros2.TRANSFORMS), ros2.offered_qos(latched=True)
    data = ros2.serialised(ros2.transforms(poses, _STAMP_NS))
    MessageWriter(writer).write(McapMessage("/tf_static", schema, data, channel), _STAMP_NS)
    writer.finish()  # type: ignore[no-untyped-call]
    return file.getvalue()
