# SPDX-License-Identifier: Apache-2.0
"""Objects of the size of vehicles and people that stand free on the ground."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from multilica.geometry import FloatArray, lengths
from multilica.registration.cells import STEPS_AROUND, cell_numbers
from multilica.results import BoolArray, IndexArray

# Below the gap between two cars in traffic, above the spacing of rings on a car at 50 m.
_CELL_M = 0.4
# Farther cells hold too few points to show an object's outline.
_RANGE_M = 60.0
# Enough to reach the ground below the bumper of a car.
_CELLS_BELOW = 2
# Bumpers and roofs of cars are higher; kerbs and the waves of a road are lower.
_GROUND_M = 0.3
# In columns of a metre: no car hides a piece of road from all LiDARs of a rig that is wider.
_COLUMNS_AROUND = 5
# Outline of the largest car with a trailer, or of a car at two places, and of a lorry with its trailer; all with a cell
# more, as outlines are of whole cells. Longer things are lower than lorries: rails, walls, hedges.
_CAR_LENGTH_M = 8.5
_LORRY_LENGTH_M = 19.0
_LORRY_HEIGHT_M = 2.4
_WIDTH_M = 3.5
# Legal height of vehicles, with the gap below the ground filter; trees, lamp posts and houses are higher.
_HEIGHT_M = 4.5
# Anything that begins higher does not stand on the ground: a sign above the road, a branch.
_CLEARANCE_M = 1.5
# A post or a trunk: thinner than a person, and at least half as high.
_POST_WIDTH_M = 0.35
_POST_HEIGHT_M = 0.8
# Edges of a parked car seem to move: such points fill a tenth as many cells as it has. Those of a car in a queue fill
# half as many or more. A person fills more than ten.
_MOVED_SHARE = 1.0 / 3.0
_MOVED_CELLS = 10
# Nearer to a LiDAR than anything but the vehicle that carries it.
_OWN_VEHICLE_M = 1.0
# Half of the neighbours: the other half sees the same pairs.
_NEIGHBOURS = [step for step in STEPS_AROUND if step > 0]


@dataclass(frozen=True, slots=True, eq=False)
class MovableCells:
    """Cells of space that movable objects fill, by one vertical.

    Args:
        rotation: (3, 3) from the frame of the rig to one with z up.
        keys: (K,) sorted numbers of the cells.
        moved: (M,) those of objects that did move.
    """

    rotation: FloatArray
    keys: IndexArray
    moved: IndexArray

    def contain(self, points_m: FloatArray) -> BoolArray:
        """Return which points (N, 3) in the frame of the rig lie on movable objects."""
        if not len(self.keys):
            return np.zeros(len(points_m), dtype=np.bool_)
        keys = cell_numbers(points_m @ self.rotation.T, _CELL_M)
        return np.asarray(self.keys[np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)] == keys)


@dataclass(frozen=True, slots=True, eq=False)
class MovableSpace:
    """Space that movable objects fill, by any vertical that may be the right one.

    Args:
        only_moved: it has only the objects that did move.
    """

    parts: tuple[MovableCells, ...]
    only_moved: bool = False

    @property
    def of_moved(self) -> "MovableSpace":
        """The space of the objects that did move."""
        parts = (MovableCells(each.rotation, each.moved, each.moved) for each in self.parts)
        return MovableSpace(tuple(parts), only_moved=True)

    @property
    def is_empty(self) -> bool:
        """True if there is no movable object."""
        return not any(len(each.keys) for each in self.parts)

    @property
    def has_moved(self) -> bool:
        """True if an object did move."""
        return any(len(each.moved) for each in self.parts)

    def contain(self, points_m: FloatArray) -> BoolArray:
        """Return which points (N, 3) in the frame of the rig lie on movable objects."""
        found = np.zeros(len(points_m), dtype=np.bool_)
        for each in self.parts:
            found |= each.contain(points_m)
        return found


def find_movable(
    points_m: FloatArray, lidars_m: FloatArray, rotations: Sequence[FloatArray], moving_m: FloatArray | None = None
) -> MovableSpace:
    """Find the space of objects that could stand elsewhere in the next scan.

    These are connected groups of cells above the ground, none larger than a vehicle. A group that touches a wall, a
    rail or a ceiling belongs to it. A row of cars that did move may be longer: cars that creep fill the gaps.

    Args:
        points_m: (N, 3) of all LiDARs in the frame of the rig.
        lidars_m: (L, 3) positions of the LiDARs.
        rotations: (3, 3) each, from that frame to one with z up; objects that are movable by one of them count.
        moving_m: (K, 3) returns that are not in `points_m`, from places where other frames found nothing.
    """
    return MovableSpace(tuple(_find_by_vertical(points_m, lidars_m, each, moving_m) for each in rotations))


def _find_by_vertical(
    points_m: FloatArray, lidars_m: FloatArray, rotation: FloatArray, moving_m: FloatArray | None
) -> MovableCells:
    middle_m = lidars_m.mean(axis=0)
    points_m = points_m[lengths(points_m - middle_m) < _RANGE_M] @ rotation.T
    above_m = above_ground(points_m)
    high = above_m > _GROUND_M
    points_m, above_m = points_m[high], above_m[high]
    if not len(points_m):
        return MovableCells(rotation, *(np.empty(0, dtype=np.int64) for _ in range(2)))
    # One point per cell is enough for an outline.
    keys, first = np.unique(cell_numbers(points_m, _CELL_M), return_index=True)
    points_m, above_m = points_m[first], above_m[first]
    count, object_of = _connected(keys)
    own = np.zeros(count, dtype=np.bool_)
    for lidar_m in lidars_m @ rotation.T:
        own[object_of[lengths(points_m - lidar_m) < _OWN_VEHICLE_M]] = True
    vehicle, row = (each & ~own for each in _outlines(points_m, above_m, object_of, count))
    moved = np.zeros(count, dtype=np.bool_)
    if moving_m is not None and len(moving_m):
        moving = np.unique(cell_numbers(moving_m @ rotation.T, _CELL_M))
        least = np.maximum(_MOVED_CELLS, _MOVED_SHARE * np.bincount(object_of, minlength=count))
        moved = _count_touching(keys, object_of, count, moving) >= least
    found, of_moved = (_with_below(keys[each[object_of]]) for each in (vehicle | (row & moved), row & moved))
    return MovableCells(rotation, found, of_moved)


def above_ground(points_m: FloatArray) -> FloatArray:
    """Return the height (N,) above the ground, which is the opening of the lowest points (Zhang et al., TGRS 2003).

    An opening takes away what is narrow, such as a car, and keeps the edge of a bridge. A column's own lowest point
    counts as well: cars whose surroundings nobody sees must not lift the ground beside them.
    """
    if not len(points_m):
        return np.empty(0)
    low_m = points_m[:, :2].min(axis=0)
    x, y = ((points_m[:, axis] - low_m[axis]).astype(np.int64) for axis in (0, 1))
    columns = y.max() + 1
    lowest_m = np.full((x.max() + 1, columns), np.inf)
    column = x * columns + y
    np.minimum.at(lowest_m.reshape(-1), column, points_m[:, 2])
    eroded_m = minimum_filter(lowest_m, _COLUMNS_AROUND, mode="nearest")
    opened_m = maximum_filter(np.where(np.isfinite(eroded_m), eroded_m, -np.inf), _COLUMNS_AROUND, mode="nearest")
    return np.asarray(points_m[:, 2] - np.minimum(lowest_m, opened_m).reshape(-1)[column])


def _with_below(keys: IndexArray) -> IndexArray:
    """Add the cells below: wheels and sills are below the height at which the ground ends."""
    return np.unique([keys - below for below in range(_CELLS_BELOW + 1)])


def _count_touching(keys: IndexArray, object_of: IndexArray, count: int, others: IndexArray) -> IndexArray:
    """Count the other cells that each object has or touches."""
    touching = []
    for step in STEPS_AROUND:
        wanted = others + step
        found = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        other = np.flatnonzero(keys[found] == wanted)
        touching.append(other * count + object_of[found[other]])
    return np.bincount(np.unique(np.concatenate(touching)) % count, minlength=count)


def _connected(keys: IndexArray) -> tuple[int, IndexArray]:
    """Return the number of groups of touching cells, and the group (K,) of each."""
    ones, others = [], []
    for step in _NEIGHBOURS:
        wanted = keys + step
        found = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        ones.append(np.flatnonzero(keys[found] == wanted))
        others.append(found[ones[-1]])
    edges = np.concatenate(ones), np.concatenate(others)
    graph = coo_array((np.ones(len(edges[0]), dtype=np.bool_), edges), shape=(len(keys), len(keys)))
    count, groups = connected_components(graph, directed=False)
    return int(count), groups.astype(np.int64)


def _outlines(
    points_m: FloatArray, above_m: FloatArray, object_of: IndexArray, count: int
) -> tuple[BoolArray, BoolArray]:
    """Return which objects have the outline of a vehicle or a person, and of a row of them as well."""
    x_m, y_m = points_m[:, :2].T
    number = np.bincount(object_of, minlength=count)
    x_m, y_m = (each - (np.bincount(object_of, each, count) / number)[object_of] for each in (x_m, y_m))
    xx, yy, xy = (np.bincount(object_of, one * other, count) for one, other in ((x_m, x_m), (y_m, y_m), (x_m, y_m)))
    yaw_rad = (0.5 * np.arctan2(2.0 * xy, xx - yy))[object_of]
    length_m = _extent(np.cos(yaw_rad) * x_m + np.sin(yaw_rad) * y_m, object_of, count)
    width_m = _extent(np.cos(yaw_rad) * y_m - np.sin(yaw_rad) * x_m, object_of, count)
    lowest_m, highest_m = np.full(count, np.inf), np.zeros(count)
    np.minimum.at(lowest_m, object_of, above_m)
    np.maximum.at(highest_m, object_of, above_m)
    # The ground of a car on a bridge may be what is below, where nobody sees the road beside it.
    highest_m = np.minimum(highest_m, lowest_m + _extent(points_m[:, 2], object_of, count))
    longest_m = np.where(highest_m > _LORRY_HEIGHT_M, _LORRY_LENGTH_M, _CAR_LENGTH_M)
    post = (np.maximum(length_m, width_m) < _POST_WIDTH_M) & (highest_m - lowest_m > _POST_HEIGHT_M)
    row = (width_m < _WIDTH_M) & (highest_m < _HEIGHT_M) & (lowest_m < _CLEARANCE_M) & ~post
    return row & (length_m < longest_m), row


def _extent(values: FloatArray, labels: IndexArray, count: int) -> FloatArray:
    lowest, highest = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(lowest, labels, values)
    np.maximum.at(highest, labels, values)
    return np.asarray(highest - lowest)
