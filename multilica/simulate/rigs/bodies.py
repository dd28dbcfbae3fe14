# SPDX-License-Identifier: Apache-2.0
"""Bodies of vehicles that carry LiDARs, in the base frame."""

from multilica.simulate.shapes.mesh import Mesh, box, merged, tapered_box, tube


def car(roof_height_m: float, roof_length_m: float, roof_width_m: float) -> Mesh:
    """Build a hull of 4.6 m by 1.8 m with a cabin whose roof carries the LiDARs."""
    hull = tapered_box((-2.3, 2.3, -0.9, 0.9), (-2.25, 2.1, -0.88, 0.88), 0.3, 0.55 * roof_height_m)
    foot = (-0.5 * roof_length_m - 0.25, 0.5 * roof_length_m + 0.5, -0.86, 0.86)
    roof = (-0.5 * roof_length_m, 0.5 * roof_length_m, -0.5 * roof_width_m, 0.5 * roof_width_m)
    return merged([hull, tapered_box(foot, roof, 0.55 * roof_height_m, roof_height_m)])


def shuttle(length_m: float, width_m: float, height_m: float) -> Mesh:
    """Build a small bus: one box with rounded shoulders."""
    half_x_m, half_y_m = length_m / 2.0, width_m / 2.0
    side = (-half_x_m, half_x_m, -half_y_m, half_y_m)
    roof = (-half_x_m + 0.1, half_x_m - 0.1, -half_y_m + 0.1, half_y_m - 0.1)
    return merged([tapered_box(side, side, 0.3, height_m - 0.2), tapered_box(side, roof, height_m - 0.2, height_m)])


def articulated_truck() -> Mesh:
    """Build a tractor with a straight trailer, 12.6 m long and low enough for a garage, with arms for its mirrors."""
    cab = tapered_box((3.3, 6.3, -1.2, 1.2), (3.4, 6.0, -1.15, 1.15), 0.5, 2.25)
    trailer = box((-6.3, -1.22, 0.9), (2.7, 1.22, 2.15))
    chassis = box((-6.0, -0.5, 0.5), (6.0, 0.5, 0.9))
    arms = box((5.46, -1.36, 1.9), (5.54, 1.36, 1.96))
    axles_x_m = (-5.2, -3.9, 3.0, 5.2)
    wheels = [tube((x, s * 0.85, 0.5), (x, s * 1.15, 0.5), 0.5, sides=14) for x in axles_x_m for s in (-1.0, 1.0)]
    return merged([cab, trailer, chassis, arms, *wheels])
