# SPDX-License-Identifier: Apache-2.0
"""Numbers of cubic cells of space."""

from itertools import product

import numpy as np

from multilica.geometry import FloatArray
from multilica.results import IndexArray

_STRIDE = 1 << 20

STEPS_AROUND = [(x * _STRIDE + y) * _STRIDE + z for x, y, z in product((-1, 0, 1), repeat=3)]
"""From the number of a cell to itself and to those that it touches, in ascending order."""


def cell_numbers(points_m: FloatArray, cell_m: float) -> IndexArray:
    """Return the number (N,) of the cell of each point (N, 3); cells above each other have consecutive numbers."""
    x, y, z = np.floor(points_m / cell_m).astype(np.int64).T + _STRIDE // 2
    return np.asarray((x * _STRIDE + y) * _STRIDE + z)
