# SPDX-License-Identifier: Apache-2.0
"""A vehicle that drives on after every second look at it: ``drive.py STOP1.mcap STOP2.mcap ...``.

A Python that has rclpy runs it. A look ends when nobody listens any more, so that none sees two stops.
"""

import sys
import time

import rclpy
from sensor_msgs.msg import PointCloud2

from tests.ros2.vehicle import PERIOD_S, read

LOOKS = 2


def main(*paths):
    stops = [read(path)["clouds"] for path in paths]
    rclpy.init()
    node = rclpy.create_node("drive")
    publishers = {topic: node.create_publisher(PointCloud2, topic, 5) for topic, _ in stops[0]}
    print("ready", flush=True)
    looks, was_heard = 0, False
    while True:
        is_heard = any(publisher.get_subscription_count() > 0 for publisher in publishers.values())
        looks, was_heard = looks + (was_heard and not is_heard), is_heard
        for topic, message in stops[min(looks // LOOKS, len(stops) - 1)]:
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(time.time_ns(), 10**9)
            publishers[topic].publish(message)
        time.sleep(PERIOD_S)


main(*sys.argv[1:])
