# SPDX-License-Identifier: Apache-2.0
"""ROS 2's own client, and the sentence on why it does not load."""

import re
import sys
from importlib.util import find_spec

from multilica.errors import MissingDependencyError
from multilica.optional_libraries import needed_for

SETUP = "source the setup file of your ROS 2, such as /opt/ros/jazzy/setup.bash"
"""An alternative to the wheels, as an imperative."""


def require_client(wanted: str) -> None:
    """Import rclpy.

    Args:
        wanted: what the user asked for, as the subject of a sentence.

    Raises:
        MissingDependencyError: there is none for this Python.
    """
    with needed_for(wanted, "rclpy", SETUP):
        try:
            import rclpy.node  # noqa: F401 - it imports what nodes need
        except ImportError as error:
            _explain_sourced(wanted, error)
            raise


def _explain_sourced(wanted: str, error: ImportError) -> None:
    """Raise MissingDependencyError if a ROS 2 is sourced that this Python cannot use."""
    if error.name == "yaml":
        raise MissingDependencyError(
            f"{wanted} needs the library yaml, which ROS 2 takes from the system; `pip install pyyaml` installs it."
        ) from error
    spec = find_spec("rclpy") if error.name != "rclpy" else None
    where = (spec.origin or "") if spec else ""
    of_ros = re.search(r"/python(3\.\d+)/", where)
    own = f"{sys.version_info.major}.{sys.version_info.minor}"
    if of_ros and of_ros[1] != own:
        raise MissingDependencyError(
            f"{wanted} needs a ROS 2 for Python {own}; the sourced one at {where[: of_ros.start()]} is for Python "
            f"{of_ros[1]}. Install multilica for that Python if it is 3.11 or newer; else "
            "`pip install 'multilica[ros2]'`, and run multilica in a shell without that setup file."
        ) from error
