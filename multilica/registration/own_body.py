# SPDX-License-Identifier: Apache-2.0
"""Parts of the vehicle that a LiDAR sees: they are in the same place of its frame at every stop."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multilica.geometry import FloatArray, lengths
from multilica.registration.cells import STEPS_AROUND, cell_numbers
from multilica.registration.movable import above_ground
from multilica.results import BoolArray, IndexArray

# Above the range noise, below the spacing of things that look like a bonnet at two stops by chance.
_CELL_M = 0.1
# The longest way from a LiDAR to the end of its vehicle that is not hidden by the vehicle itself.
_REACH_M = 10.0
# The ground is in the same place as well.
_GROUND_M = 0.3
# Fewer points are chance. More of what is near: the vehicle stands where it stood.
_MIN_POINTS = 30
_MAX_SHARE = 0.7


@dataclass(frozen=True, slots=True, eq=False)
class BodyCells:
    """Cells (K,) of a LiDAR's frame that its own vehicle fills, as sorted numbers."""

    keys: IndexArray

    @classmethod
    def none(cls) -> "BodyCells":
        """Return that there are none."""
        return cls(np.empty(0, dtype=np.int64))

    def contain(self, points_m: FloatArray) -> BoolArray:
        """Return which points (N, 3) lie on the vehicle."""
        return np.isin(cell_numbers(points_m, _CELL_M), self.keys)


def find_own_body(stops: Sequence[FloatArray], rotations: Sequence[FloatArray]) -> BodyCells:
    """Find the cells that are filled at every stop, above the ground.

    Args:
        stops: per stop the points (N, 3) of one LiDAR in its own frame.
        rotations: (3, 3) from that frame to those that may have z up.
    """
    near = [points_m[lengths(points_m) < _REACH_M] for points_m in stops]
    if len(near) < 2 or any(len(points_m) < _MIN_POINTS for points_m in near):
        return BodyCells.none()
    first_m = near[0]
    for rotation in rotations:
        first_m = first_m[above_ground(first_m @ rotation.T) > _GROUND_M]
    keys = cell_numbers(first_m, _CELL_M)
    same = np.unique(keys)
    for points_m in near[1:]:
        same = same[_touch(same, np.unique(cell_numbers(points_m, _CELL_M)))]
    count = np.count_nonzero(np.isin(keys, same))
    if count < _MIN_POINTS or count > _MAX_SHARE * len(first_m):
        return BodyCells.none()
    return BodyCells(np.unique(np.concatenate([same + step for step in STEPS_AROUND])))


def _touch(keys: IndexArray, others: IndexArray) -> BoolArray:
    """Return which cells are among others, which are sorted, or next to one of them."""
    found = np.zeros(len(keys), dtype=np.bool_)
    for step in STEPS_AROUND:
        places = np.minimum(np.searchsorted(others, keys + step), len(others) - 1)
        found |= others[places] == keys + step
    return found
