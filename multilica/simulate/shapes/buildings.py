# SPDX-License-Identifier: Apache-2.0
"""Buildings with facades that have relief."""

import numpy as np

from multilica.geometry import FloatArray
from multilica.simulate.shapes.mesh import Mesh, box, merged, quads, tube


class _FacadeStyle:
    """Random sizes of the facade of a European town house; storeys from floor to floor, windows width by height."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.bay_m = rng.uniform(2.0, 4.2)
        self.storey_m = rng.uniform(2.7, 3.6)
        self.ground_storey_m = rng.uniform(3.0, 4.5)
        self.window_m = (rng.uniform(0.9, 1.8), rng.uniform(1.2, 2.0))
        self.recess_m = rng.uniform(0.08, 0.35)
        self.balcony_share = float(rng.choice([0.0, 0.0, 0.15, 0.4]))
        self.cornice_m = float(rng.choice([0.0, 0.08, 0.2]))


def _wall(x_cuts_m: FloatArray, z_cuts_m: FloatArray, recess_m: FloatArray) -> Mesh:
    """Build a wall in the plane y = 0, its cells pushed to +y by `recess_m`, with the reveals between cells.

    Args:
        x_cuts_m: (X + 1,) borders of the columns; z_cuts_m: (Z + 1,) borders of the rows.
        recess_m: (X, Z) depth of each cell.
    """
    x0, z0 = np.meshgrid(x_cuts_m[:-1], z_cuts_m[:-1], indexing="ij")
    x1, z1 = np.meshgrid(x_cuts_m[1:], z_cuts_m[1:], indexing="ij")
    panes = _stack((x0, recess_m, z0), (x1, recess_m, z0), (x1, recess_m, z1), (x0, recess_m, z1))
    left, right = recess_m[:-1], recess_m[1:]
    x = x1[:-1]
    jambs = _stack((x, left, z0[1:]), (x, right, z0[1:]), (x, right, z1[1:]), (x, left, z1[1:]))
    below, above = recess_m[:, :-1], recess_m[:, 1:]
    z = z1[:, :-1]
    sills = _stack((x0[:, 1:], below, z), (x1[:, 1:], below, z), (x1[:, 1:], above, z), (x0[:, 1:], above, z))
    return merged([quads(panes), quads(jambs), quads(sills)])


def _stack(*corners: tuple[FloatArray, FloatArray, FloatArray]) -> FloatArray:
    return np.stack([np.stack(corner, axis=-1) for corner in corners], axis=-2).reshape(-1, 4, 3)


def _facade(rng: np.random.Generator, style: _FacadeStyle, width_m: float, storeys: int) -> Mesh:
    """Build a street front in the plane y = 0 from x = 0 to the width, looking towards -y."""
    bays = max(1, int(width_m / style.bay_m))
    pitch_m = width_m / bays
    opening_m = min(style.window_m[0], 0.8 * pitch_m)
    starts = pitch_m * np.arange(bays) + (pitch_m - opening_m) / 2.0
    x_cuts = np.concatenate([[0.0], np.column_stack([starts, starts + opening_m]).ravel(), [width_m]])
    floors = np.concatenate([[0.0], style.ground_storey_m + style.storey_m * np.arange(storeys)])
    sills = floors[:-1] + np.where(np.arange(storeys) == 0, 0.5, 0.9)
    heads = np.minimum(sills + np.where(np.arange(storeys) == 0, 2.2, style.window_m[1]), floors[1:] - 0.25)
    z_cuts = np.concatenate([[-1.5], np.column_stack([sills, heads]).ravel(), [floors[-1]]])
    recess = np.zeros((len(x_cuts) - 1, len(z_cuts) - 1))
    recess[1::2, 1::2] = style.recess_m * rng.choice([0.0, 1.0, 1.0, 1.0, 1.0, 2.0], size=(bays, storeys))
    parts = [_wall(x_cuts, z_cuts, recess)]
    parts += [_balcony(x, floors[s]) for s in range(1, storeys) for x in starts if rng.random() < style.balcony_share]
    if style.cornice_m > 0.0:
        parts += [box((0.0, -style.cornice_m, z - 0.25), (width_m, 0.05, z)) for z in floors[1:]]
    parts.append(_doorway(float(rng.choice(starts)), opening_m))
    return merged(parts)


def _balcony(x_m: float, floor_m: float) -> Mesh:
    slab = box((x_m - 0.5, -1.2, floor_m - 0.15), (x_m + 2.0, 0.0, floor_m))
    parapet = box((x_m - 0.5, -1.2, floor_m), (x_m + 2.0, -1.1, floor_m + 1.0))
    cheeks = [box((x, -1.2, floor_m), (x + 0.06, 0.0, floor_m + 1.0)) for x in (x_m - 0.5, x_m + 1.94)]
    return merged([slab, parapet, *cheeks])


def _doorway(x_m: float, width_m: float) -> Mesh:
    """Build two steps with a canopy above them."""
    sizes = ((0.7, 0.15), (0.35, 0.3))
    steps = [box((x_m - 0.2, -depth, -0.5), (x_m + width_m + 0.2, 0.0, top)) for depth, top in sizes]
    canopy = box((x_m - 0.3, -0.9, 2.6), (x_m + width_m + 0.3, 0.0, 2.75))
    return merged([*steps, canopy])


def _pitched_roof(width_m: float, depth_m: float, eaves_m: float, rise_m: float, overhang_m: float) -> Mesh:
    """Build a gable roof whose ridge runs along x, over the rectangle from the origin to (width, depth)."""
    y0, y1, middle = -overhang_m, depth_m + overhang_m, depth_m / 2.0
    ridge = eaves_m + rise_m
    slopes = [
        [[0.0, y, eaves_m], [width_m, y, eaves_m], [width_m, middle, ridge], [0.0, middle, ridge]] for y in (y0, y1)
    ]
    gables = [[[x, y0, eaves_m], [x, y1, eaves_m], [x, middle, ridge], [x, middle, ridge]] for x in (0.0, width_m)]
    return quads(np.array(slopes + gables))


def building(rng: np.random.Generator, width_m: float, depth_m: float) -> Mesh:
    """Build a house with its front in the plane y = 0, looking towards -y, from x = 0 to the width."""
    style, storeys = _FacadeStyle(rng), int(rng.integers(2, 7))
    height_m = style.ground_storey_m + style.storey_m * (storeys - 1)
    front = _facade(rng, style, width_m, storeys)
    back = _facade(rng, style, width_m, storeys).moved(width_m, depth_m, 0.0, np.pi)
    ends_m = (0.0, width_m)
    sides = quads([[[x, 0, -1.5], [x, depth_m, -1.5], [x, depth_m, height_m], [x, 0, height_m]] for x in ends_m])
    roof = _pitched_roof(width_m, depth_m, height_m, rng.uniform(0.3, 4.5), rng.uniform(0.1, 0.7))
    pipe_x_m = float(rng.choice([0.15, width_m - 0.15]))
    downpipe = tube((pipe_x_m, -0.08, -0.5), (pipe_x_m, -0.08, height_m), 0.06, sides=6)
    chimney_m = rng.uniform(0.2, 0.8) * width_m
    chimney = box((chimney_m, depth_m * 0.4, height_m), (chimney_m + 0.8, depth_m * 0.4 + 0.6, height_m + 5.0))
    return merged([front, back, sides, roof, downpipe, chimney])


def shed(rng: np.random.Generator) -> Mesh:
    """Build a wooden shed with a door, a lean-to, a woodpile."""
    width_m, depth_m, height_m = rng.uniform(4.0, 9.0), rng.uniform(3.0, 6.0), rng.uniform(2.3, 3.5)
    body = box((0.0, 0.0, -0.5), (width_m, depth_m, height_m))
    door_m = rng.uniform(0.1, 0.5) * width_m
    door = box((door_m, -0.1, 0.0), (door_m + 1.2, 0.1, 2.0))
    roof = _pitched_roof(width_m, depth_m, height_m, rng.uniform(0.8, 2.0), 0.4)
    lean_to = box((width_m, 0.4, -0.5), (width_m + rng.uniform(1.5, 3.0), depth_m - 0.5, height_m * 0.6))
    pile = box((-1.4, 0.3, -0.3), (-0.3, 0.7 * depth_m, rng.uniform(0.8, 1.5)))
    return merged([body, door, roof, lean_to, pile]).moved(-width_m / 2.0, -depth_m / 2.0)
