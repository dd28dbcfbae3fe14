# SPDX-License-Identifier: Apache-2.0
"""Information of poses that a perturbation or a doubt widens along a direction."""

from dataclasses import replace

import numpy as np

from multilica.geometry import LEVER_ARM_M, FloatArray
from multilica.results import BiasInformation, PairRegistration


def widened(information: FloatArray, direction: FloatArray, off_m: float) -> FloatArray:
    """Return the information of a pose from its offset along a direction after a perturbation.

    Args:
        information: of the pose, and perhaps of biases after it.
        direction: (6,) as `VisibilityScore.weakest_direction`.
    """
    step = np.zeros(len(information))
    step[:6] = off_m * direction / np.repeat([LEVER_ARM_M, 1.0], 3)
    pulled = information @ step
    return np.asarray(information - np.outer(pulled, pulled) / (1.0 + step @ pulled))


def widened_with_biases(found: BiasInformation, direction: FloatArray, off_m: float) -> BiasInformation:
    """Widen information and spread alike: both covariances grow by the offset."""
    information = widened(found.information, direction, off_m)
    step = np.zeros(len(information))
    step[:6] = off_m * direction / np.repeat([LEVER_ARM_M, 1.0], 3)
    pulled = information @ step
    kept = np.eye(len(information)) - np.outer(pulled, step)
    after = found.with_spreads_changed(kept)
    return replace(after, information=information, spread=after.spread + np.outer(pulled, pulled))


def widened_along(pair: PairRegistration, direction: FloatArray, off_m: float) -> PairRegistration:
    """Return a registration whose pose has a further error of this standard deviation along a direction.

    Args:
        direction: (6,) as `VisibilityScore.weakest_direction`.
    """
    information, found = pair.information, pair.bias_information
    return replace(
        pair,
        information=None if information is None else widened(information, direction, off_m),
        bias_information=None if found is None else widened_with_biases(found, direction, off_m),
    )


def widened_everywhere(pair: PairRegistration, sigma_rad: float, sigma_m: float) -> PairRegistration:
    """Return a registration whose pose has further errors of these standard deviations about and along each axis."""
    for direction, off_m in zip(np.eye(6), np.repeat([LEVER_ARM_M * sigma_rad, sigma_m], 3), strict=True):
        pair = widened_along(pair, direction, off_m)
    return pair


def loosened(pair: PairRegistration, factor: float) -> PairRegistration:
    """Return a registration whose pose and biases have standard deviations that are larger by a factor."""
    if pair.information is None:
        return pair
    share, found = factor**-2.0, pair.bias_information
    if found is not None:
        found = replace(
            found.with_spreads_changed(np.sqrt(share) * np.eye(len(found.gradient))),
            information=share * found.information,
            gradient=share * found.gradient,
        )
    return replace(pair, information=share * pair.information, bias_information=found)
