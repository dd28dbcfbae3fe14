# SPDX-License-Identifier: Apache-2.0
"""Latched messages for those who listen now or later: on topics of ROS 2, and from a Foxglove WebSocket server."""
