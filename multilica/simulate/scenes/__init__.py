# SPDX-License-Identifier: Apache-2.0
"""Procedural scenes, by name."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from multilica.simulate.scenes.countryside import fence_field, open_field
from multilica.simulate.scenes.garage import garage, symmetric_garage
from multilica.simulate.scenes.parking import parking
from multilica.simulate.scenes.scene import Scene
from multilica.simulate.scenes.street import street
from multilica.simulate.scenes.tunnel import tunnel

__all__ = ["SCENES", "Scene"]

SCENES: Mapping[str, Callable[[np.random.Generator], Scene]] = MappingProxyType(
    {
        builder.__name__: builder
        for builder in (fence_field, garage, open_field, parking, street, symmetric_garage, tunnel)
    }
)
