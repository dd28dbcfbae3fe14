# SPDX-License-Identifier: Apache-2.0
"""The levels of the first array on /diagnostics that tells an outcome, as JSON: ``diagnostics.py OUTCOME``."""

import json
import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray


def main(outcome):
    found = []
    rclpy.init()
    node = rclpy.create_node("diagnostics")

    def hear(message):
        if outcome in message.status[0].message:
            found.append({status.name: status.level[0] for status in message.status})

    node.create_subscription(DiagnosticArray, "/diagnostics", hear, 10)
    end_s = time.monotonic() + 50.0
    while not found and time.monotonic() < end_s:
        rclpy.spin_once(node, timeout_sec=0.1)
    print(json.dumps(found[0]))


main(*sys.argv[1:])
