# SPDX-License-Identifier: Apache-2.0
"""A running vehicle, verified whenever it stands."""

from multilica.watch.loop import Observation, WatchRequest, watch_vehicle

__all__ = ["Observation", "WatchRequest", "watch_vehicle"]
