# SPDX-License-Identifier: Apache-2.0
"""Verification of a pair's hypotheses by free space."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt
import scipy
from scipy.spatial.transform import Rotation

from multilica.acceptance.accept import cannot_be_accepted, is_well_constrained, min_competing_evidence
from multilica.config import CalibrationConfig, FineConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.registration.gicp import SHORT_ITERATIONS, GicpCloud, register_narrower
from multilica.registration.poses import is_distinct, slid_hypotheses, within_baseline
from multilica.results import PRIOR, CoarseResult, Hypothesis, Registration
from multilica.visibility.sensor_view import ROUGH_TOLERANCES, SensorView, score_registration, score_visibility

# Coarse poses are off by about a voxel of the descriptors and a degree: the true one among them then scores best.
_COARSE_TOLERANCE_M = 0.3
_COARSE_TOLERANCE_DEG = 1.0
# Before the short GICP, true poses had at least 1 more than the limit, and none won that was 10 behind the best.
_COARSE_MARGIN = 4.0
_COARSE_LEAD = 10.0
# Symmetric poses come from plans with cells of 0.5 m, slid ones from steps of 1 m.
_COMPETING_TOLERANCE_M = 0.6
# Distinct poses after which the search may stop early; fewer are enough if the best is well constrained.
_EARLY_STOP_POSES = 6
_EARLY_STOP_POSES_CONSTRAINED = 2
_MAX_SYMMETRIC_POSES = 6
# The short GICP; a denser cloud is thinned further.
_SHORT_VOXEL_M = 0.5
_SHORT_POINTS = 4000

# GICP corrects an error of one cell; 256 cells span the common view of two LiDARs.
_CELL_M = 0.5
_CELLS = 256
# Nearer maxima belong to one pose.
_APART_M = 2.0
# Surfaces steeper than 45 deg are walls.
_STRUCTURE = float(np.cos(np.deg2rad(45.0)))
# Fewer points of walls make no plan.
_MIN_POINTS = 50


@dataclass(frozen=True, slots=True, eq=False)
class VerificationCloud:
    """One LiDAR's view with its cloud as prepared for `short_gicp`."""

    view: SensorView
    cloud: GicpCloud


def short_gicp(fine: FineConfig) -> FineConfig:
    """Return the settings of the short GICP: coarse grid, few iterations, loose convergence."""
    return fine.model_copy(
        update={
            "engine": "small_gicp",
            "voxel_size_m": _SHORT_VOXEL_M,
            "max_points": _SHORT_POINTS,
            "max_correspondence_distances_m": (2.0, 1.0, 0.5),
            "max_iterations": SHORT_ITERATIONS,
            "translation_epsilon_m": 1e-3,
            "rotation_epsilon_rad": 1e-3,
            "fitness_distance_m": 0.5,
        }
    )


def verify_hypotheses(
    target: VerificationCloud, source: VerificationCloud, coarse: CoarseResult, config: CalibrationConfig
) -> tuple[Registration, ...]:
    """Score the hypotheses by the beams of both sensors, and register the promising ones by a short GICP.

    A beam that returned from 20 m proves that the 20 m before it are empty: points that a pose puts there violate it,
    points on measured surfaces agree, points behind surfaces prove nothing. Hypotheses near an earlier result are
    skipped, and so is the rest once one pose is clearly correct. Poses that may compete with the best are tested as
    well: turned by right angles, and shifted along its weakest direction if it is not well constrained.

    The prior does not influence which hypotheses are tested: in a symmetric scene a wrong prior could otherwise end
    the search before the true pose is tested.

    Returns:
        The distinct poses, the one with the most evidence first.
    """
    gicp, max_baseline_m = short_gicp(config.fine), config.acceptance.max_baseline_m
    from_prior: list[Registration] = []
    found: list[Registration] = []
    for hypothesis in _promising(target, source, coarse.hypotheses, config):
        known = from_prior if hypothesis.origin == PRIOR else found
        if known is found and _is_settled(found, config):
            continue
        if not is_distinct(hypothesis.T_target_source, (other.T_target_source for other in known)):
            continue
        for registration in _registered(target, source, hypothesis, gicp, config):
            if is_distinct(registration.T_target_source, (other.T_target_source for other in known)):
                known.append(registration)
    for registration in from_prior:
        found = _joined(found, registration)
    tolerances = _COMPETING_TOLERANCE_M, ROUGH_TOLERANCES[1]
    for hypothesis, settings in _competing_hypotheses(target.view, source.view, found, gicp, config):
        pose = hypothesis.T_target_source
        if not is_distinct(pose, (other.T_target_source for other in found)):
            continue
        rough = score_visibility(target.view.alone, source.view.alone, pose, *tolerances)
        best = max(each.evidence for each in within_baseline(found, max_baseline_m))
        if rough.evidence(float(np.linalg.norm(pose.xyz_m))) > min_competing_evidence(best, config.acceptance):
            found = _joined(found, _register(target, source, hypothesis, settings))
    return tuple(sorted(within_baseline(found, max_baseline_m), key=lambda each: -each.evidence))


def _promising(
    target: VerificationCloud, source: VerificationCloud, hypotheses: Sequence[Hypothesis], config: CalibrationConfig
) -> list[Hypothesis]:
    """Select the hypotheses that beams do not contradict as they are, the one with the most evidence first.

    The hypothesis of the prior is always one of them.
    """
    score = partial(score_visibility, target.view.alone, source.view.alone)
    poses = [each.T_target_source for each in hypotheses]
    evidence = [
        score(pose, _COARSE_TOLERANCE_M, _COARSE_TOLERANCE_DEG).evidence(float(np.linalg.norm(pose.xyz_m)))
        for pose in poses
    ]
    ranked = sorted(range(len(hypotheses)), key=lambda index: -evidence[index])
    if not ranked:
        return []
    best = max((each for each, one in zip(evidence, hypotheses, strict=True) if one.origin != PRIOR), default=0.0)
    needed = min(best, max(best - _COARSE_LEAD, config.acceptance.min_evidence - _COARSE_MARGIN))
    return [hypotheses[index] for index in ranked if evidence[index] >= needed or hypotheses[index].origin == PRIOR]


def _joined(found: Sequence[Registration], further: Registration) -> list[Registration]:
    """Add a registration: as a pose of its own, or in place of a worse one of the same pose."""
    same = [other for other in found if not is_distinct(further.T_target_source, [other.T_target_source])]
    if any(other.evidence >= further.evidence for other in same):
        return list(found)
    return [further, *(other for other in found if other not in same)]


def _competing_hypotheses(
    target: SensorView, source: SensorView, found: Sequence[Registration], gicp: FineConfig, config: CalibrationConfig
) -> list[tuple[Hypothesis, FineConfig]]:
    """Return poses that may score as well as the best, with their GICP: turned, or slid if it is not well constrained.

    A pose that only points in empty space speak against may be turned or slid from the true one. A pose of the prior
    is turned even if nothing speaks for it: a LiDAR may be drawn the wrong way round.

    A turned pose is off by less than a cell; a slid one needs the longest correspondence distance.
    """
    acceptance = config.acceptance
    max_baseline_m = acceptance.max_baseline_m
    best = max(within_baseline(found, max_baseline_m), key=lambda each: each.evidence, default=None)
    if best is None:
        return []
    uncontradicted = best.evidence + best.visibility.contradiction
    if cannot_be_accepted(uncontradicted, acceptance) and best.origin != PRIOR:
        return []
    pose, up = best.T_target_source, best.visibility.commonest_normal
    near = gicp.model_copy(update={"max_correspondence_distances_m": gicp.max_correspondence_distances_m[1:]})
    turned = symmetric_poses(target, source, pose, up, max_baseline_m, _MAX_SYMMETRIC_POSES)
    start = Hypothesis(pose, origin=best.origin, index=best.hypothesis)
    along: list[Hypothesis] = []
    if not is_well_constrained(best.visibility, acceptance):
        along = slid_hypotheses(start, best.visibility.slide_direction, max_baseline_m)
    return [
        *(
            (
                replace(
                    start, T_target_source=each, derivation=f"turned by {np.degrees(pose.distance_to(each)[1]):.0f} deg"
                ),
                near,
            )
            for each in turned
        ),
        *((each, gicp) for each in along),
    ]


def _registered(
    target: VerificationCloud,
    source: VerificationCloud,
    hypothesis: Hypothesis,
    gicp: FineConfig,
    config: CalibrationConfig,
) -> list[Registration]:
    """Register a hypothesis; one that GICP carried away is registered among near points as well.

    Narrow views share few points: most points within 2 m may be no matches, and draw even the true pose away.
    """
    far = _register(target, source, hypothesis, gicp)
    if not is_distinct(far.T_target_source, [hypothesis.T_target_source]):
        return [far]
    nearest = gicp.model_copy(update={"max_correspondence_distances_m": gicp.max_correspondence_distances_m[-1:]})
    near = _register(target, source, hypothesis, nearest)
    better = near.evidence > far.evidence and not cannot_be_accepted(near.evidence, config.acceptance)
    return [near, far] if better else [far]


def _register(
    target: VerificationCloud, source: VerificationCloud, hypothesis: Hypothesis, gicp: FineConfig
) -> Registration:
    start = hypothesis.T_target_source
    found = register_narrower(target.cloud, source.cloud, start, gicp)
    found = replace(found, T_target_source=found.T_target_source.with_target(start.target))
    return score_registration(found, hypothesis, target.view.alone, source.view.alone, *ROUGH_TOLERANCES)


def _is_settled(found: Sequence[Registration], config: CalibrationConfig) -> bool:
    """Return whether one pose leads so clearly that the other hypotheses, which have fewer matches, are skipped."""
    acceptance = config.acceptance
    found = within_baseline(found, acceptance.max_baseline_m)
    if len(found) < 2:
        return False
    best, second = sorted(found, key=lambda each: -each.evidence)[:2]
    constrained = is_well_constrained(best.visibility, acceptance)
    return (
        len(found) >= (_EARLY_STOP_POSES_CONSTRAINED if constrained else _EARLY_STOP_POSES)
        and best.evidence >= acceptance.min_evidence
        and second.evidence <= min_competing_evidence(best.evidence, acceptance)
    )


def symmetric_poses(
    target: SensorView, source: SensorView, pose: RigidTransform, up: FloatArray, max_baseline_m: float, most: int
) -> list[RigidTransform]:
    """Find poses at which the walls of both sensors coincide after a turn by 90, 180 or 270 degrees.

    A hall, a garage or a street looks much the same from its other end, and a search by descriptors finds either pose
    by chance. Plans of the walls, seen along `up`, are correlated over all shifts to find the other one.

    Args:
        pose: ``T_target_source`` to find competing poses of.
        up: (3,) unit, the commonest surface normal in the target's frame, the axis of the turns.

    Returns:
        Poses whose plans share at least half as many cells as those of `pose`, the best first.
    """
    walls_m, seen_m = _walls(target, up), pose.rotate(_walls(source, pose.rotation.T @ up))
    if min(len(walls_m), len(seen_m)) < _MIN_POINTS:
        return []
    across = np.linalg.svd(up[None])[2][1:]
    plan: npt.NDArray[np.complex128] = np.fft.rfft2(
        scipy.ndimage.maximum_filter(_plan((walls_m - pose.xyz_m) @ across.T), 3, mode="wrap")
    )
    needed = 0.5 * _overlap(plan, seen_m @ across.T)[0, 0]
    found: list[tuple[float, RigidTransform]] = []
    for quarter in (1, 2, 3):
        turn = Rotation.from_rotvec(0.5 * np.pi * quarter * up).as_matrix()
        cells, shifts_m = _maxima(_overlap(plan, seen_m @ turn.T @ across.T), max(needed, 1.0))
        positions_m = pose.xyz_m + shifts_m @ across
        near = np.flatnonzero(np.linalg.norm(positions_m, axis=1) <= max_baseline_m)
        for index in near[_apart(shifts_m[near], most)]:
            turned = RigidTransform.from_rotation_translation(
                pose.target, pose.source, turn @ pose.rotation, positions_m[index]
            )
            found.append((float(cells[index]), turned))
    return [turned for _, turned in sorted(found, key=lambda each: -each[0])[:most]]


def _walls(view: SensorView, up: FloatArray) -> FloatArray:
    upright = np.abs(view.normals @ up) < _STRUCTURE
    return np.asarray(view.probes_m[upright & np.any(view.normals, axis=1)])


def _plan(points_m: FloatArray) -> FloatArray:
    """Compute the (C, C) occupancy of cells seen from above; the origin in cell (0, 0), negative ones wrapped."""
    plan = np.zeros((_CELLS, _CELLS))
    cells = np.floor(points_m / _CELL_M + 0.5).astype(np.int64)
    cells = cells[np.all(np.abs(cells) < _CELLS // 2, axis=1)] % _CELLS
    plan[cells[:, 0], cells[:, 1]] = 1.0
    return plan


def _overlap(plan: npt.NDArray[np.complex128], points_m: FloatArray) -> FloatArray:
    """Count, per shift of the points in cells, the cells that coincide; (C, C)."""
    overlap = np.fft.irfft2(plan * np.conj(np.fft.rfft2(_plan(points_m))), s=(_CELLS, _CELLS))
    return np.asarray(np.rint(overlap), dtype=np.float64)


def _maxima(overlap: FloatArray, needed: float) -> tuple[FloatArray, FloatArray]:
    """Return local maxima with at least this many cells: their cells (N,), most first, and shifts (N, 2) in metres."""
    width = int(_APART_M / _CELL_M) + 1
    highest = scipy.ndimage.maximum_filter(overlap, width, mode="wrap")
    cells = np.argwhere((overlap >= highest - 0.5) & (overlap >= needed))
    cells = cells[np.argsort(-overlap[cells[:, 0], cells[:, 1]], kind="stable")]
    shifts_m = _CELL_M * (((cells + _CELLS // 2) % _CELLS) - _CELLS // 2).astype(np.float64)
    return overlap[cells[:, 0], cells[:, 1]], shifts_m


def _apart(shifts_m: FloatArray, most: int) -> list[int]:
    """Select the first shifts that are not near an earlier one."""
    kept: list[int] = []
    for index, shift_m in enumerate(shifts_m):
        if len(kept) == most:
            break
        if np.all(np.linalg.norm(shifts_m[kept] - shift_m, axis=1) >= _APART_M):
            kept.append(index)
    return kept
