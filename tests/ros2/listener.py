# SPDX-License-Identifier: Apache-2.0
"""What a node hears of `multilica publish`, as JSON: ``listener.py TARGET SOURCE``, by a Python that has rclpy.

It comes late, subscribes as tf2 and RViz do, and looks up the transform from SOURCE to TARGET.
"""

import json
import sys
import time

import numpy as np
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2

from multilica.ros2.transforms_type import transforms_class

LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE)


def matrix(transform):
    found = np.eye(4)
    turn, shift = transform.rotation, transform.translation
    found[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
    found[:3, 3] = shift.x, shift.y, shift.z
    return found


def looked_up(static, target, source):
    """The transform between two frames below one root."""
    store = get_typestore(Stores.ROS2_JAZZY)
    message = store.deserialize_cdr(static, "tf2_msgs/msg/TFMessage")
    to_root = {each.child_frame_id: matrix(each.transform) for each in message.transforms}
    (root,) = {each.header.frame_id for each in message.transforms}
    to_root[root] = np.eye(4)
    return np.linalg.inv(to_root[target]) @ to_root[source]


def main(target, source):
    heard = {}
    rclpy.init()
    node = rclpy.create_node("listener")
    node.create_subscription(
        transforms_class(), "/tf_static", lambda data: heard.update(static=data), LATCHED, raw=True
    )
    node.create_subscription(PointCloud2, "/multilica/points", lambda cloud: heard.update(cloud=cloud), LATCHED)
    end_s = time.monotonic() + 20.0
    while len(heard) < 2 and time.monotonic() < end_s:
        rclpy.spin_once(node, timeout_sec=0.1)
    cloud = heard["cloud"]
    print(
        json.dumps(
            {
                "transform": looked_up(heard["static"], target, source).tolist(),
                "frame": cloud.header.frame_id,
                "points": cloud.width * cloud.height,
            }
        )
    )


main(*sys.argv[1:])
