# SPDX-License-Identifier: Apache-2.0
"""Procedural scenes, by name."""

from collections.abc import Callable, Mapping

import numpy as np

from multilica.simulate.scenes.outdoors import fence_field, open_field, parking, street
from multilica.simulate.scenes.roads import avenue, bridge, motorway, motorway_exit
from multilica.simulate.scenes.scene import Scene
from multilica.simulate.scenes.towns import equal_houses, town
from multilica.simulate.scenes.underground import garage, symmetric_garage, tunnel, tunnel_niches
from multilica.simulate.scenes.yards import car_park, court, yard

__all__ = ["SCENES", "Scene"]

SCENES: Mapping[str, Callable[[np.random.Generator], Scene]] = {
    builder.__name__: builder
    for builder in (
        avenue,
        bridge,
        car_park,
        court,
        equal_houses,
        fence_field,
        garage,
        motorway,
        motorway_exit,
        open_field,
        parking,
        street,
        symmetric_garage,
        town,
        tunnel,
        tunnel_niches,
        yard,
    )
}
