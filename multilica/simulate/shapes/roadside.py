# SPDX-License-Identifier: Apache-2.0
"""Rails, walls and gantries beside and above roads."""

import numpy as np

from multilica.simulate.shapes.mesh import Mesh, box, extrusion, merged, repeated

_RAIL_POST_M, _WALL_POST_M, _RAILING_POST_M = 4.0, 5.0, 2.0
# Ridges and grooves of a steel beam: y towards the road, z.
_BEAM_M = ((0.0, 0.44), (0.08, 0.50), (0.0, 0.57), (0.0, 0.62), (0.08, 0.69), (0.0, 0.75))


def guard_rail(half_length_m: float, first_m: float) -> Mesh:
    """Build a rail along x for traffic on its +y side, with a post every 4 m; one stands `first_m` from an end."""
    post = box((-0.05, -0.18, -0.4), (0.05, -0.08, 0.75))
    spacer = box((-0.04, -0.08, 0.5), (0.04, 0.0, 0.7))
    spots_m = np.arange(-half_length_m + first_m, half_length_m, _RAIL_POST_M)
    beam = extrusion(_BEAM_M, -half_length_m, half_length_m)
    return merged([beam, repeated(merged([post, spacer]), spots_m)])


def noise_wall(half_length_m: float, height_m: float, first_m: float) -> Mesh:
    """Build a wall along x of panels between posts, one every 5 m; one stands `first_m` from an end."""
    panels = box((-half_length_m, -0.06, -0.3), (half_length_m, 0.06, height_m))
    post = box((-0.12, -0.15, -0.3), (0.12, 0.15, height_m + 0.1))
    return merged([panels, repeated(post, np.arange(-half_length_m + first_m, half_length_m, _WALL_POST_M))])


def gantry(rng: np.random.Generator, y0_m: float, y1_m: float) -> Mesh:
    """Build a gantry over the road from one column to the other, with signs of different sizes across x."""
    columns = [box((-0.2, y - 0.2, -0.3), (0.2, y + 0.2, 7.0)) for y in (y0_m, y1_m)]
    chords = [box((-0.15, y0_m, z), (0.15, y1_m, z + 0.15)) for z in (5.9, 6.85)]
    struts = [box((-0.08, y - 0.05, 6.05), (0.08, y + 0.05, 6.85)) for y in np.arange(y0_m + 1.0, y1_m, 1.5)]
    signs, left_m = [], y0_m + rng.uniform(0.6, 1.5)
    while left_m < y1_m - 2.0:
        width_m, height_m = min(rng.uniform(1.2, 4.5), y1_m - left_m), rng.uniform(1.2, 2.6)
        signs.append(box((-0.3, left_m, 5.7), (-0.22, left_m + width_m, 5.7 + height_m)))
        left_m += width_m + rng.uniform(0.4, 1.6)
    return merged([*columns, *chords, *struts, *signs])


def railing(half_length_m: float, pitch_m: float) -> Mesh:
    """Build a railing along x with a post every 2 m and equal balusters at the pitch between two bars."""
    bars = [box((-half_length_m, -0.04, z), (half_length_m, 0.04, z + 0.05)) for z in (0.1, 1.1)]
    post = box((-0.04, -0.04, -0.1), (0.04, 0.04, 1.1))
    baluster = box((-0.012, -0.012, 0.15), (0.012, 0.012, 1.1))
    posts = repeated(post, np.arange(-half_length_m, half_length_m, _RAILING_POST_M))
    return merged([*bars, posts, repeated(baluster, np.arange(-half_length_m, half_length_m, pitch_m))])
