# SPDX-License-Identifier: Apache-2.0
"""Scene of a long straight road tunnel."""

import numpy as np

from multilica.simulate.scenes.scene import Scene
from multilica.simulate.shapes.primitives import extrusion
from multilica.simulate.shapes.terrain import FLAT

__all__ = ["tunnel"]

_HALF_LENGTH_M = 250.0


def tunnel(rng: np.random.Generator) -> Scene:
    """Build a vault over a road with walkways; all cross-sections are equal, so x is not observable."""
    half_m, wall_m = rng.uniform(4.5, 6.5), rng.uniform(2.5, 4.0)
    walkway_m, kerb_m = rng.uniform(0.8, 1.3, size=2), rng.uniform(0.15, 0.3)
    angles = np.linspace(0.0, np.pi, 25)
    rise_m = rng.uniform(0.6, 1.0) * half_m
    vault = np.column_stack([half_m * np.cos(angles), wall_m + rise_m * np.sin(angles)])
    right = [[-half_m, kerb_m], [-half_m + walkway_m[0], kerb_m], [-half_m + walkway_m[0], 0.0]]
    left = [[half_m - walkway_m[1], 0.0], [half_m - walkway_m[1], kerb_m], [half_m, kerb_m], [half_m, wall_m]]
    profile = np.concatenate([vault, right, left])
    yaw_rad = rng.normal(scale=0.04)
    return Scene(extrusion(profile, -_HALF_LENGTH_M, _HALF_LENGTH_M), FLAT, (0.0, rng.uniform(-0.8, 0.8)), yaw_rad, 4.0)
