# SPDX-License-Identifier: Apache-2.0
"""Latched messages on topics of ROS 2."""

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager

from multilica.ros2 import Ros2Node
from multilica.sinks.mcap.messages import McapMessage


@contextmanager
def on_ros2_topics(messages: Sequence[McapMessage]) -> Iterator[None]:
    """Publish a CDR message per topic, latched, within the block.

    Raises:
        MultilicaError: as `Ros2Node` and its `publisher`.
    """
    with closing(Ros2Node("Publishing at ros2://")) as node:
        for message in messages:
            node.publisher(message.topic, message.schema.name, latched=True)(message.data)
        yield
