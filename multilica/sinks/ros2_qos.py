# SPDX-License-Identifier: Apache-2.0
"""How a topic is to be offered again when a recording is played to ROS 2."""

from __future__ import annotations

__all__ = ["offered_qos"]

_PROFILE = """\
- history: 1
  depth: {depth}
  reliability: 1
  durability: {durability}
  deadline: &forever
    sec: 9223372036
    nsec: 854775807
  lifespan: *forever
  liveliness: 1
  liveliness_lease_duration: *forever
  avoid_ros_namespace_conventions: false
"""
_TRANSIENT_LOCAL = 1
_VOLATILE = 2


def offered_qos(*, latched: bool) -> dict[str, str]:
    """What rosbag2 reads from the metadata of an MCAP channel.

    Args:
        latched: who subscribes later gets the last message, as with `/tf_static`.
    """
    depth, durability = (1, _TRANSIENT_LOCAL) if latched else (10, _VOLATILE)
    return {"offered_qos_profiles": _PROFILE.format(depth=depth, durability=durability)}
