# SPDX-License-Identifier: Apache-2.0
"""A node that hears and sends messages as CDR bytes."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from multilica.errors import MissingDependencyError, UsageError, escape_controls
from multilica.ros2.client import require_client
from multilica.ros2.transforms_type import TRANSFORMS, transforms_class

_NO_LOG_FILE = ["--ros-args", "--disable-external-lib-logs"]
"""The log file of ROS 2 needs a home directory, which services have not; this node writes nothing into it."""
_QUEUE = 4
"""Scans that the middleware keeps while one is decoded."""
_LATCHED_QUEUE = 100


@dataclass(frozen=True, slots=True)
class Offer:
    """The quality of service that every publisher of a topic offers."""

    reliable: bool
    latched: bool


class Ros2Node:
    """A node of its own context; domain and middleware come from the environment variables of ROS 2.

    Args:
        wanted: what the user asked for, as the subject of a sentence.

    Raises:
        MissingDependencyError: there is no ROS 2 client for this Python.
        UsageError: it does not start with these environment variables.
    """

    def __init__(self, wanted: str) -> None:
        require_client(wanted)
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.parameter import Parameter
        from rclpy.signals import SignalHandlerOptions

        self._context = rclpy.Context()
        try:
            rclpy.init(args=_NO_LOG_FILE, context=self._context, signal_handler_options=SignalHandlerOptions.NO)
            self._node = rclpy.create_node(
                "multilica",
                context=self._context,
                enable_rosout=False,
                start_parameter_services=False,
                parameter_overrides=[Parameter("start_type_description_service", value=False)],
            )
        except Exception as error:
            text = escape_controls(str(error).strip().partition("\n")[0]).rstrip(".")
            raise UsageError(
                f"ROS 2 does not start ({text[:200]}); check ROS_DOMAIN_ID and RMW_IMPLEMENTATION."
            ) from error
        self._published: list[str] = []
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)

    def topics(self) -> dict[str, str]:
        """Return topic -> message type of what other nodes publish; of several types, the first by name."""
        offered = self._node.get_topic_names_and_types()
        return {
            name: min(types)
            for name, types in offered
            if name not in ("/parameter_events", "/rosout")
            and self._node.count_publishers(name) > self._published.count(name)
        }

    def offer(self, topic: str) -> Offer | None:
        """Return what all publishers of a topic offer; None without publishers."""
        from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

        profiles = [info.qos_profile for info in self._node.get_publishers_info_by_topic(topic)]
        if not profiles:
            return None
        return Offer(
            all(profile.reliability != ReliabilityPolicy.BEST_EFFORT for profile in profiles),
            all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles),
        )

    def subscribe(
        self, topic: str, message_type: str, offer: Offer, hear: Callable[[bytes, int], None]
    ) -> Callable[[], None]:
        """Call `hear` within `spin` with each message and the time it arrived, in ns; return what ends that.

        Raises:
            MissingDependencyError: the package of the message type is not installed.
        """
        kind = _class_of(message_type, f"Listening to '{topic}'")
        subscription = self._node.create_subscription(
            kind, topic, lambda data, info: hear(data, _arrival_ns(info)), _profile(offer), raw=True
        )
        return lambda: _ignore(self._node.destroy_subscription(subscription))

    def publisher(self, topic: str, message_type: str, *, latched: bool) -> Callable[[bytes], None]:
        """Return a function that publishes a message reliably, to those who come later too if it is latched.

        Raises:
            MissingDependencyError: the package of the message type is not installed.
        """
        kind = _class_of(message_type, f"Publishing on '{topic}'")
        profile = _profile(Offer(reliable=True, latched=latched), depth=1)
        send = self._node.create_publisher(kind, topic, profile).publish
        self._published.append(topic)
        return lambda data: _ignore(send(data))

    def spin(self, timeout_s: float) -> None:
        """Handle one message, or wait for one."""
        self._executor.spin_once(timeout_sec=timeout_s)

    def close(self) -> None:
        """Leave the network."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()


def _profile(offer: Offer, depth: int = 0) -> Any:  # noqa: ANN401 - rclpy is imported late
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    return QoSProfile(
        depth=depth or (_LATCHED_QUEUE if offer.latched else _QUEUE),
        reliability=ReliabilityPolicy.RELIABLE if offer.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if offer.latched else DurabilityPolicy.VOLATILE,
    )


def _class_of(message_type: str, wanted: str) -> Any:  # noqa: ANN401 - a class made by rosidl
    from importlib import import_module

    package, _, name = message_type.replace("/msg/", "/").partition("/")
    try:
        kind = getattr(import_module(f"{package}.msg"), name)
        type(kind).__import_type_support__()
    except Exception as error:  # one of several, if the package or its libraries are missing
        if message_type == TRANSFORMS:
            return transforms_class()
        raise MissingDependencyError(
            f"{wanted} needs the message type {message_type}, which is not installed for this Python; source the "
            f"workspace that has the package {package}."
        ) from error
    return kind


def _arrival_ns(info: Mapping[str, int]) -> int:
    """Return when the middleware received a message; now, if it does not tell.

    Messages may wait in its queue while types are loaded and scans are decoded.
    """
    received_ns = info.get("received_timestamp", 0)
    return received_ns if received_ns > 0 else time.time_ns()


def _ignore(_: object) -> None:
    pass
