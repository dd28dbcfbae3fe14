# SPDX-License-Identifier: Apache-2.0
"""Equations of all pairs at once against those of one pair after the other."""

import numpy as np
import pytest

from multilica.multi_snapshot.pair_equations import LARGEST_RESIDUAL, PairEquations
from multilica.registration.view_poses import ViewPoses
from tests.multi_snapshot.made_drive import LIDARS, STOPS, pairs

_VIEWS = ViewPoses(dict(LIDARS), dict(STOPS), ["B", "C"], ["stop 2", "stop 3", "stop 4"])


def _one_by_one(poses, of_pairs, error):
    squared, information = 0.0, np.zeros((poses.columns, poses.columns))
    gradient = np.zeros(poses.columns)
    for each in of_pairs:
        offset, (jacobian, columns) = poses.offset(each), poses.jacobian(each)
        weights = np.linalg.inv(np.linalg.inv(each.registration.information) + error)
        own = offset @ weights @ offset / LARGEST_RESIDUAL
        squared += LARGEST_RESIDUAL * np.log1p(own)
        information[np.ix_(columns, columns)] += jacobian.T @ weights @ jacobian / (1.0 + own)
        gradient[columns] += jacobian.T @ weights @ offset / (1.0 + own)
    return squared, information, gradient


@pytest.mark.parametrize("error", [None, np.diag(np.repeat([1e-4, 1e-2], 3))], ids=["sure", "rough"])
def test_all_pairs_at_once_are_as_one_by_one(error):
    """Within a stop, between stops, of one LiDAR at two stops, and of the root alone."""
    rng = np.random.default_rng(3)
    poses = _VIEWS.moved(rng.normal(scale=0.1, size=_VIEWS.columns))
    of_pairs = pairs("A1-B1 B3-C3 A1-B2 B2-C4 C2-C3 A2-A4", rng, noise=4.0)
    found = PairEquations.of(poses, of_pairs, error=error).at(poses)
    expected = _one_by_one(poses, of_pairs, np.zeros((6, 6)) if error is None else error)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-8 * np.abs(other).max())


def test_without_pairs_nothing_is_known():
    squared, information, gradient = PairEquations.of(_VIEWS, []).at(_VIEWS)
    assert squared == 0.0
    assert not information.any()
    assert not gradient.any()
    assert information.shape == (30, 30)
