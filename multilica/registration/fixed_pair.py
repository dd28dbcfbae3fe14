# SPDX-License-Identifier: Apache-2.0
"""Information of a pair without the objects that could have moved between the scans of its LiDARs."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from multilica.geometry import LEVER_ARM_M, FloatArray
from multilica.registration.gicp import GicpCloud
from multilica.registration.plane_fit import PlaneFit, fixed_information
from multilica.registration.widening import widened, widened_with_biases
from multilica.results import BoolArray, PairRegistration

# A smaller share of the information changes sigma by less than a third.
_LEAST_SHARE = 0.4
# Half the distance at which points match: with a larger standard deviation, what is left does not hold the pose.
_FREE_M = 0.1
# LiDARs that are not synchronised scan up to 0.1 s apart: a car at 110 km/h goes 3 m, any part of it alike.
_MOTION_M = 3.0 / np.sqrt(3.0)
_SCALE = np.repeat([1.0 / LEVER_ARM_M, 1.0], 3)


def without_movable(
    pair: PairRegistration,
    clouds: tuple[GicpCloud, GicpCloud],
    movable: tuple[BoolArray, BoolArray],
    bias_sigmas: FloatArray,
) -> PairRegistration | None:
    """Return the pair with the information that fixed objects give; None if movable ones hold little of it.

    In directions that fixed objects leave free, the pose may be off by the motion of a car.

    Args:
        clouds: of target and source.
        movable: which of their points lie on movable objects.
    """
    fitted = PlaneFit(pair.T_target_source, pair.information, pair.bias_information)
    share, fixed = fixed_information(*clouds, fitted, bias_sigmas, movable, _LEAST_SHARE)
    if share < _LEAST_SHARE:
        return None
    if fixed is None or fixed.information is None:
        return replace(pair, information=np.diag((_MOTION_M * _SCALE) ** -2.0), bias_information=None)
    information, of_biases = fixed.information, fixed.biases
    for direction in _free_directions(information):
        information = widened(information, direction, _MOTION_M)
        of_biases = None if of_biases is None else widened_with_biases(of_biases, direction, _MOTION_M)
    if of_biases is not None and fixed.biases is not None:
        # The pose that fits best stays where it is: less information pulls less towards it.
        kept = of_biases.information @ np.linalg.pinv(fixed.biases.information, hermitian=True)
        of_biases = replace(of_biases, gradient=kept @ fixed.biases.gradient)
    return replace(pair, information=information, bias_information=of_biases)


def _free_directions(information: FloatArray) -> Sequence[FloatArray]:
    """Return the directions (6,) in which the pose is not held; rotations count as arcs at 10 m."""
    values, directions = np.linalg.eigh(information * np.outer(_SCALE, _SCALE))
    return list(directions.T[values < _FREE_M**-2.0])
