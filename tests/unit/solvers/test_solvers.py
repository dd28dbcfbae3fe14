# SPDX-License-Identifier: Apache-2.0
import sys
from importlib.util import find_spec

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica.config import CoarseConfig
from multilica.errors import MissingDependencyError
from multilica.geometry import RigidTransform
from multilica.results import Correspondences
from multilica.solvers import SOLVERS
from multilica.stages.coarse import find_hypotheses

_PACKAGES = {"kiss_matcher": "kiss_matcher", "teaserpp": "teaserpp_python"}
_WRONG_SHARE = 0.9
_CONFIG = CoarseConfig(noise_bound_m=0.2)


@pytest.fixture(params=SOLVERS)
def solver(request):
    package = _PACKAGES.get(request.param)
    if package is not None and find_spec(package) is None:
        pytest.skip(f"{package} is not installed")
    return request.param


def _truth(seed):
    rotation = Rotation.random(random_state=seed).as_matrix()
    return RigidTransform.from_rotation_translation("t", "s", rotation, [1.5, -0.7, 0.4])


def _matches(seed, count, wrong_share):
    """Matches of surface points with 5 cm of noise; the wrong ones end on another point's place."""
    rng = np.random.default_rng(seed)
    truth = _truth(seed)
    source = rng.uniform([-25, -25, -3], [25, 25, 6], (count, 3))
    normals = rng.normal(size=source.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    target, target_normals = truth.apply(source) + rng.normal(0, 0.02, source.shape), truth.rotate(normals)
    wrong = np.arange(round(wrong_share * count))
    target[wrong], target_normals[wrong] = np.roll(target[wrong], 1, axis=0), np.roll(target_normals[wrong], 1, axis=0)
    order = rng.permutation(count)
    arrays = (array[order] for array in (target, source, target_normals, normals))
    return Correspondences("t", "s", *arrays, np.zeros(count), order, order)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_finds_the_pose_that_the_right_matches_agree_on(solver, seed):
    matches = _matches(seed, 600, _WRONG_SHARE)
    best, *_ = SOLVERS[solver](matches, _CONFIG).poses
    metres, radians = best.distance_to(_truth(seed))
    assert metres < 0.1
    assert radians < np.deg2rad(0.5)


def test_the_stage_names_the_solver_and_counts_who_agrees(solver):

    coarse = find_hypotheses(_matches(1, 600, _WRONG_SHARE), _CONFIG.model_copy(update={"solver": solver}), 100.0)
    best = coarse.hypotheses[0]
    assert best.T_target_source.distance_to(_truth(1))[0] < 0.1
    assert best.origin == solver
    assert best.score == best.inliers.sum() == pytest.approx((1 - _WRONG_SHARE) * 600, rel=0.1)


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_a_handful_of_matches_is_no_crash(solver, count):
    coarse = find_hypotheses(_matches(1, count, 0.0), _CONFIG.model_copy(update={"solver": solver}), 100.0)
    assert len(coarse.hypotheses) <= 1
    if count < 3:
        assert coarse.hypotheses == ()


def test_the_same_matches_give_the_same_bits(solver):
    matches = _matches(4, 400, _WRONG_SHARE)
    first, second = (SOLVERS[solver](matches, _CONFIG).poses for _ in range(2))
    assert [pose.matrix.tobytes() for pose in first] == [pose.matrix.tobytes() for pose in second]


@pytest.mark.parametrize(("name", "instead"), [("kiss_matcher", "cliques"), ("teaserpp", "maximum_clique")])
def test_a_solver_that_is_not_installed_says_how_to_get_on(name, instead, monkeypatch):
    monkeypatch.setitem(sys.modules, _PACKAGES[name], None)
    with pytest.raises(
        MissingDependencyError,
        match=rf"'{name}' needs the library .* not installed; `pip .*` installs it, or set coarse\.solver={instead}",
    ):
        SOLVERS[name](_matches(1, 50, 0.0), CoarseConfig(solver=name))


def test_without_teaserpp_the_same_is_solved_without_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "teaserpp_python", None)
    coarse = find_hypotheses(_matches(1, 600, 0.9), CoarseConfig(noise_bound_m=0.2, solver="teaserpp"), 100.0)
    assert coarse.hypotheses[0].origin == "maximum_clique"
    assert coarse.clique_size >= 60
