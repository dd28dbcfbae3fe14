# SPDX-License-Identifier: Apache-2.0
"""GICP of two roughly aligned clouds, by small_gicp or Open3D."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import small_gicp

from multilica.config import FineConfig
from multilica.geometry import Z_AXIS, FloatArray, RigidTransform
from multilica.registration.creep import Creep
from multilica.registration.lazy_open3d import o3d
from multilica.registration.neighbours import PointTree, Surface, thin, thin_from_cloud
from multilica.results import GicpStep, PairRegistration
from multilica.time_limit import require_time

# Growth of the voxels until the cloud is small enough: a step removes about a third of the points.
_COARSER = 1.2

SHORT_ITERATIONS = 10
"""Iterations for a pose that may prove wrong."""

# Iterations between two recorded steps.
_OBSERVED_ITERATIONS = 2
# Only the last of the correspondence distances has to converge fully.
_LOOSER = 10.0
# Longest leap of a registration that creeps, in correspondence distances.
_LEAP = 0.5

# Unbounded neighbour searches are slowest for points far from everything. Points beyond this many correspondence
# distances, which GICP cannot bring back, are left out if that saves a fifth; some stay, for their covariances.
_REACH = 4.0
_WORTH_CROPPING = 0.8
_MIN_POINTS = 20

# Points that show whether a cloud has more points on single scan lines than edges and posts have.
_LINE_SAMPLE = 1000
_FEW_ON_LINES = 0.03

# The published code of the paper: variance along the normal, and change of fitness and RMSE below which it ends.
_OPEN3D_EPSILON = 0.005
_OPEN3D_CONVERGED = 1e-7


@dataclass(frozen=True, eq=False)
class GicpCloud:
    """Thinned points with the engine's structures.

    Args:
        name: the LiDAR, or the root of a group.
        points_m: (N, 3) in the frame of that name.
        tree: nearest neighbours among `points_m`.
        engine: name of the engine.
        neighbours: points from which a covariance or a normal is estimated.
        elevation_axis: (3,) of the LiDAR's frame.
    """

    name: str
    points_m: FloatArray
    tree: PointTree
    engine: str
    neighbours: int
    elevation_axis: FloatArray = field(default_factory=lambda: Z_AXIS)

    def __reduce__(self) -> tuple[Any, ...]:
        """Leave out the engine's types, which cannot be pickled, and are the same bits when computed again."""
        values = self.name, self.points_m, self.tree, self.engine, self.neighbours, self.elevation_axis
        return GicpCloud, values

    @cached_property
    def engine_cloud(self) -> Any:  # noqa: ANN401 - the engines' types have nothing in common
        """The engine's own type, with covariances; that of Open3D with normals, from which it makes them.

        Computed on first use: a cloud of which GICP takes a part needs none.
        """
        if self.engine == "small_gicp":
            small_gicp.estimate_covariances(
                self.tree.cloud, self.tree.engine, num_neighbors=self.neighbours, num_threads=1
            )
            return self.tree.cloud
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(self.points_m))
        cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(self.neighbours))
        return cloud

    @cached_property
    def is_sparse(self) -> bool:
        """True if many of its points have neighbours on one scan line only, more than on edges and posts."""
        some = np.arange(0, len(self.points_m), max(1, len(self.points_m) // _LINE_SAMPLE))
        return bool(np.mean(self.surface.on_line(some)) > _FEW_ON_LINES)

    @cached_property
    def surface(self) -> Surface:
        """Planes that its points lie on."""
        return Surface(self.tree, self.neighbours)


def prepare_gicp_cloud(
    name: str, points_m: FloatArray, config: FineConfig, elevation_axis: FloatArray = Z_AXIS
) -> GicpCloud:
    """Thin a cloud on the engine's grid."""
    thinned_on_grid = thin if config.engine == "small_gicp" else thin_from_cloud
    thinned, voxel_size_m = thinned_on_grid(points_m, config.voxel_size_m), config.voxel_size_m
    while len(thinned) > config.max_points:
        voxel_size_m *= _COARSER
        thinned = thinned_on_grid(thinned, voxel_size_m)
    tree = PointTree(thinned)
    return GicpCloud(name, tree.points_m, tree, config.engine, config.neighbours, elevation_axis)


def register(
    target: GicpCloud, source: GicpCloud, T_target_source: RigidTransform, config: FineConfig
) -> PairRegistration:
    """Run GICP (Segal et al., RSS 2009) from coarse to fine correspondence distances.

    Args:
        T_target_source: where to start.

    Returns:
        The pose with `fitness` and `rmse_m` as `fitness_and_rmse` defines them, for both engines.

    Raises:
        OutOfTime: the time for the search is over.
    """
    require_time()
    small = config.engine == "small_gicp"
    run = _run_small_gicp if small else _run_open3d
    state = _Gicp(T_target_source, len(source.points_m))
    within_reach = _within_reach(target, source, T_target_source, config) if small else source
    converged: bool | None = True
    for distance_m in config.max_correspondence_distances_m:
        state = run(state, target, within_reach, distance_m, config)
        converged = state.converged if converged else converged
    fit = state.fit if config.fitness_distance_m == config.max_correspondence_distances_m[-1] else None
    fitness, rmse_m, inliers = fit or fitness_and_rmse(target, source, state.pose, config.fitness_distance_m)
    return PairRegistration(
        target=target.name,
        source=source.name,
        T_target_source=state.pose,
        fitness=fitness,
        rmse_m=rmse_m,
        inliers=inliers,
        converged=converged,
        iterations=state.iterations,
        engine=config.engine,
        hessian=state.hessian,
        steps=state.steps,
    )


def register_narrower(
    first: GicpCloud, second: GicpCloud, T_first_second: RigidTransform, config: FineConfig
) -> PairRegistration:
    """Register the cloud with fewer points, as the source, to the other.

    A narrow sensor shares nearly all its points with a wide one; the other way round the same pose has little fitness
    and costs more.
    """
    if len(second.points_m) > len(first.points_m):
        return register(second, first, T_first_second.inverse(), config)
    return register(first, second, T_first_second, config)


def fitness_and_rmse(
    target: GicpCloud, source: GicpCloud, T_target_source: RigidTransform, distance_m: float
) -> tuple[float, float, int]:
    """Return the share of source points with a target point within the distance, their RMS distance and number.

    Open3D calls these fitness and inlier RMSE; the paper's threshold of 0.2 is one of fitness. Without inliers the
    RMSE is infinite.
    """
    _, distances_m, _ = target.tree.nearest_within(T_target_source.apply(source.points_m), distance_m)
    if len(distances_m) == 0:
        return 0.0, float("inf"), 0
    rmse_m = float(np.sqrt(np.mean(distances_m**2)))
    return len(distances_m) / len(source.points_m), rmse_m, len(distances_m)


@dataclass(frozen=True, slots=True, eq=False)
class _Gicp:
    """State of a GICP run.

    Args:
        points: number of source points, those out of reach included.
        fit: fitness, RMSE and inliers within the correspondence distance; None where the engine does not give them.
    """

    pose: RigidTransform
    points: int
    iterations: int | None = 0
    converged: bool | None = False
    hessian: FloatArray | None = None
    steps: tuple[GicpStep, ...] = ()
    fit: tuple[float, float, int] | None = None


def _within_reach(
    target: GicpCloud, source: GicpCloud, T_target_source: RigidTransform, config: FineConfig
) -> GicpCloud:
    reach_m = _REACH * max(config.max_correspondence_distances_m)
    near, *_ = target.tree.nearest_within(T_target_source.apply(source.points_m), reach_m)
    if len(near) < _MIN_POINTS:
        near = np.union1d(near, np.arange(min(_MIN_POINTS, len(source.points_m))))
    if len(near) > _WORTH_CROPPING * len(source.points_m):
        return source
    return prepare_gicp_cloud(source.name, source.points_m[near], config)


def _run_small_gicp(state: _Gicp, target: GicpCloud, source: GicpCloud, distance_m: float, config: FineConfig) -> _Gicp:
    """Run a few iterations at a time, to record the progress and to leap where it creeps; few in all go at once."""
    creep, looser, at_once = Creep(), 1.0, SHORT_ITERATIONS
    if config.max_iterations > SHORT_ITERATIONS:
        looser = 1.0 if distance_m == config.max_correspondence_distances_m[-1] else _LOOSER
        at_once = _OBSERVED_ITERATIONS
    for start in range(0, config.max_iterations, at_once):
        result = small_gicp.align(
            target.engine_cloud,
            source.engine_cloud,
            target.tree.engine,
            init_T_target_source=state.pose.matrix,
            registration_type="GICP",
            max_correspondence_distance=distance_m,
            num_threads=1,
            max_iterations=min(at_once, config.max_iterations - start),
            rotation_epsilon=looser * config.rotation_epsilon_rad,
            translation_epsilon=looser * config.translation_epsilon_m,
        )
        before, iterations = state.pose, (state.iterations or 0) + result.iterations + 1
        pose, inliers = _moved(before, result.T_target_source), int(result.num_inliers)
        share, error = inliers / state.points, float(result.error)
        step = GicpStep(iterations, distance_m, inliers, share, error, *before.distance_to(pose))
        hessian, steps = np.array(result.H), (*state.steps, step)
        state = _Gicp(pose, state.points, iterations, bool(result.converged), hessian, steps)
        if state.converged:
            break
        if start + at_once < config.max_iterations:
            state = replace(state, pose=creep.leap(before, pose, _LEAP * distance_m))
    return state


def _run_open3d(state: _Gicp, target: GicpCloud, source: GicpCloud, distance_m: float, config: FineConfig) -> _Gicp:
    registration = o3d.pipelines.registration
    result = registration.registration_generalized_icp(
        source.engine_cloud,
        target.engine_cloud,
        distance_m,
        state.pose.matrix,
        registration.TransformationEstimationForGeneralizedICP(epsilon=_OPEN3D_EPSILON),
        registration.ICPConvergenceCriteria(_OPEN3D_CONVERGED, _OPEN3D_CONVERGED, config.max_iterations),
    )
    inliers, pose = len(result.correspondence_set), _moved(state.pose, np.asarray(result.transformation))
    fit = (float(result.fitness), float(result.inlier_rmse), inliers) if inliers else None
    # Open3D reports neither; without matches it has certainly not converged.
    return _Gicp(pose, state.points, iterations=None, converged=None if inliers else False, fit=fit)


def _moved(pose: RigidTransform, matrix: FloatArray) -> RigidTransform:
    return RigidTransform.from_rotation_translation(pose.target, pose.source, matrix[:3, :3], matrix[:3, 3])
