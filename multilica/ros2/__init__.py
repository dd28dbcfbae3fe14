# SPDX-License-Identifier: Apache-2.0
"""A ROS 2 node for messages as bytes, by ROS 2's own client."""

from multilica.ros2.node import Offer, Ros2Node
from multilica.ros2.transforms_type import TRANSFORMS

__all__ = ["TRANSFORMS", "Offer", "Ros2Node"]
