# SPDX-License-Identifier: Apache-2.0
"""A vehicle whose nodes publish what an MCAP file holds: ``vehicle.py FILE WAY``, by a Python that has rclpy.

WAY is ``once``, ``lossy`` (every fifth scan is lost, the log over and over again), or ``dying`` (eight scans of each).
Clouds are offered as best effort unless they are published once; what is on /tf_static is latched.
"""

import sys
import time
from pathlib import Path

import rclpy
from mcap.reader import make_reader
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2

from multilica.ros2.transforms_type import transforms_class

PERIOD_S = 0.02
STATIC = "/tf_static"


def read(path):
    with Path(path).open("rb") as file:
        messages = [(channel.topic, raw.data) for _, channel, raw in make_reader(file).iter_messages()]
    return {
        "clouds": [(topic, deserialize_message(data, PointCloud2)) for topic, data in messages if "points" in topic],
        "static": [data for topic, data in messages if topic == STATIC],
    }


def main(path, way):
    recorded = read(path)
    rclpy.init()
    node = rclpy.create_node("vehicle")
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE)
    static = node.create_publisher(transforms_class(), STATIC, latched)
    for data in recorded["static"]:
        static.publish(data)
    offered = ReliabilityPolicy.RELIABLE if way == "once" else ReliabilityPolicy.BEST_EFFORT
    quality = QoSProfile(depth=20, reliability=offered)
    publishers = {topic: node.create_publisher(PointCloud2, topic, quality) for topic in dict(recorded["clouds"])}
    print("ready", flush=True)
    while not all(publisher.get_subscription_count() for publisher in publishers.values()):
        time.sleep(0.02)
    sent = 0
    while True:
        for topic, message in recorded["clouds"]:
            sent += 1
            if way == "lossy" and sent % 5 == 0:
                continue
            if way == "dying" and sent > 8 * len(publishers):
                return
            if way != "once":
                message.header.stamp.sec, message.header.stamp.nanosec = divmod(time.time_ns(), 10**9)
            publishers[topic].publish(message)
            time.sleep(PERIOD_S)
        if way == "once":
            time.sleep(60.0)


if __name__ == "__main__":
    main(*sys.argv[1:])
