# SPDX-License-Identifier: Apache-2.0
"""Verification of a pair's hypotheses by free space."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from multilica.acceptance.accept import (
    cannot_be_accepted,
    is_in_long_place,
    is_surely_ambiguous,
    is_well_constrained,
    likeliest_first,
    min_competing_evidence,
    surely_competing,
)
from multilica.config import CalibrationConfig, FineConfig
from multilica.geometry import RigidTransform
from multilica.registration.gicp import SHORT_ITERATIONS, GicpCloud, register_narrower
from multilica.registration.poses import SLIDE_STEP_M, is_distinct, slid_hypotheses, within_baseline
from multilica.results import PRIOR, CoarseResult, Hypothesis, PairRegistration, Registration
from multilica.visibility.plans import alike_hypotheses
from multilica.visibility.sensor_view import (
    COMPETING_TOLERANCES,
    ROUGH_TOLERANCES,
    SensorView,
    may_compete,
    score_registration,
    score_visibility,
)

# Coarse poses are off by about a voxel of the descriptors and a degree: the true one among them then scores best.
_COARSE_TOLERANCE_M = 0.3
_COARSE_TOLERANCE_DEG = 1.0
# Before the short GICP, true poses had at least 1 more than the limit, and none won that was 10 behind the best.
_COARSE_MARGIN = 4.0
_COARSE_LEAD = 10.0
# Slid poses as near as this are always tested; farther ones as long as none competes with the best.
_NEAR_SLIDE_M = 6.0
# Presets without a largest baseline would slide without end. By default, views of linked stops are 40 m apart at most.
_FARTHEST_SLIDE_M = 80.0
# Distinct poses after which the search may stop early; fewer are enough if the best is well constrained.
_EARLY_STOP_POSES = 6
_EARLY_STOP_POSES_CONSTRAINED = 2
_MAX_SYMMETRIC_POSES = 6
# Beside poses that were accepted in the end, at most three competed before these were registered.
_SURELY_COMPETING = 6
_TURNED_RAD = 0.25 * np.pi
# The short GICP; a denser cloud is thinned further.
_SHORT_VOXEL_M = 0.5
_SHORT_POINTS = 4000


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
    target: VerificationCloud,
    source: VerificationCloud,
    coarse: CoarseResult,
    config: CalibrationConfig,
    refused: Sequence[RigidTransform] | None = None,
) -> tuple[Registration, ...]:
    """Score the hypotheses by the beams of both sensors, and register the promising ones by a short GICP.

    A beam that returned from 20 m proves that the 20 m before it are empty: points that a pose puts there violate it,
    points on measured surfaces agree, points behind surfaces prove nothing. Hypotheses near an earlier result are
    skipped, and so is the rest once one pose is clearly correct. Poses that may compete with the best are tested as
    well: turned by right angles, shifted to where what stands above the ground repeats, and shifted along its weakest
    direction if it is not well constrained.

    The prior does not influence which hypotheses are tested: in a symmetric scene a wrong prior could otherwise end
    the search before the true pose is tested.

    Args:
        refused: poses of an earlier search with other descriptors. Then only poses that may be accepted are registered,
            and none if all of them were refused before.

    Returns:
        The distinct poses, the one that leads all others first, the rest by evidence.
    """
    gicp = short_gicp(config.fine)
    hypotheses = _promising(target, source, coarse.hypotheses, config, even_the_best=refused is not None)
    found = _registered_in_turn(target, source, hypotheses, gicp, config)
    if refused is not None and not any(
        is_distinct(each.T_target_source, refused)
        for each in found
        if not cannot_be_accepted(each.evidence, config.acceptance)
    ):
        return ()
    ranked = _ranked(found, config)
    for hypothesis, settings in _competing_hypotheses(target.view, source.view, ranked, gicp, config):
        if _is_undecidable(ranked, config):
            return tuple(ranked)
        ranked = _with_competing(target, source, ranked, hypothesis, settings, config)
    if not ranked or cannot_be_accepted(ranked[0].evidence, config.acceptance) or target.view.at_stop:
        return tuple(ranked)
    ranked = _up_to_a_competitor(target, source, ranked, _with(gicp, _far_slides(ranked[0], config)), config)
    return tuple(_up_to_a_competitor(target, source, ranked, _with(gicp, _turned_slides(ranked, config)), config))


def find_poses_beside(
    target: VerificationCloud,
    source: VerificationCloud,
    registered: PairRegistration,
    config: CalibrationConfig,
    *,
    led: bool,
) -> list[Registration]:
    """Find poses that may compete with a registered one and that `verify_hypotheses` did not test.

    Along a tunnel, poses that slide score best in the verification, and one far away may win in the end: only then its
    own turned, repeated and slid poses can be tested, up to one that surely competes.

    Between stops, poses far along the weakest direction of any pose are tested. Posts of a rail and niches of a tunnel
    repeat after any number of periods. On a vehicle, the nearest pose that fits is the likeliest by far. Between stops
    no distance is likelier than another, so all of them count. Only a pose that would be accepted is worth this: along
    a bare wall every other pose fits as well.

    Args:
        registered: of these two LiDARs, in either order; so are the poses.
        led: the registered pose was the best one after the verification, beside which others were tested.
    """
    if registered.target != target.view.lidar:
        target, source = source, target
    best, *others = registered.registrations
    score = score_visibility(target.view.alone, source.view.alone, best.T_target_source, *ROUGH_TOLERANCES)
    known = [replace(best, visibility=score), *others]
    gicp = short_gicp(config.fine)
    slides, ranked = _with(gicp, _far_slides(known[0], config)), _ranked(known, config)
    if led:
        for hypothesis, settings in slides:
            ranked = _with_competing(target, source, ranked, hypothesis, settings, config)
    else:
        beside = _competing_hypotheses(target.view, source.view, known[:1], gicp, config)
        ranked = _up_to_a_competitor(target, source, ranked, [*beside, *slides], config)
        ranked = _up_to_a_competitor(target, source, ranked, _with(gicp, _turned_slides(ranked, config)), config)
    return [each for each in ranked if all(each is not other for other in known)]


def _up_to_a_competitor(
    target: VerificationCloud,
    source: VerificationCloud,
    ranked: list[Registration],
    hypotheses: Sequence[tuple[Hypothesis, FineConfig]],
    config: CalibrationConfig,
) -> list[Registration]:
    """Add hypotheses as `_with_competing` does, until one surely competes with the best pose."""
    tested = None
    for hypothesis, settings in hypotheses:
        if ranked is not tested and is_surely_ambiguous(ranked, config.acceptance):
            break
        tested = ranked
        ranked = _with_competing(target, source, ranked, hypothesis, settings, config)
    return ranked


def _with(gicp: FineConfig, hypotheses: Sequence[Hypothesis]) -> list[tuple[Hypothesis, FineConfig]]:
    return [(each, gicp) for each in hypotheses]


def _registered_in_turn(
    target: VerificationCloud,
    source: VerificationCloud,
    hypotheses: Sequence[Hypothesis],
    gicp: FineConfig,
    config: CalibrationConfig,
) -> list[Registration]:
    """Register the hypotheses that are not near an earlier result, until one is clearly correct or too many compete."""
    from_prior: list[Registration] = []
    found: list[Registration] = []
    for hypothesis in hypotheses:
        known = from_prior if hypothesis.origin == PRIOR else found
        if known is found and (_is_settled(found, config) or _is_undecidable(_ranked(found, config), config)):
            continue
        if not is_distinct(hypothesis.T_target_source, (other.T_target_source for other in known)):
            continue
        for registration in _registered(target, source, hypothesis, gicp, config):
            if is_distinct(registration.T_target_source, (other.T_target_source for other in known)):
                known.append(registration)
    for registration in from_prior:
        found = _joined(found, registration)
    return found


def _ranked(found: Sequence[Registration], config: CalibrationConfig) -> list[Registration]:
    return likeliest_first(within_baseline(found, config.acceptance.max_baseline_m))


def _with_competing(
    target: VerificationCloud,
    source: VerificationCloud,
    ranked: list[Registration],
    hypothesis: Hypothesis,
    gicp: FineConfig,
    config: CalibrationConfig,
) -> list[Registration]:
    """Register a hypothesis that is new and may compete with the best pose, the first one, and add it."""
    pose, best = hypothesis.T_target_source, ranked[0]
    if not is_distinct(pose, (other.T_target_source for other in ranked)):
        return ranked
    least = min_competing_evidence(best.evidence, config.acceptance)
    if not may_compete(target.view, source.view, pose, best, least, *COMPETING_TOLERANCES):
        return ranked
    return _ranked(_joined(ranked, _register(target, source, hypothesis, gicp)), config)


def _promising(
    target: VerificationCloud,
    source: VerificationCloud,
    hypotheses: Sequence[Hypothesis],
    config: CalibrationConfig,
    *,
    even_the_best: bool,
) -> list[Hypothesis]:
    """Select the hypotheses that beams do not contradict as they are, the one with the most evidence first.

    The hypothesis of the prior is always one of them, and so is the best unless `even_the_best` has to be promising.
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
    needed = max(best - _COARSE_LEAD, config.acceptance.min_evidence - _COARSE_MARGIN)
    if not even_the_best:
        needed = min(best, needed)
    return [hypotheses[index] for index in ranked if evidence[index] >= needed or hypotheses[index].origin == PRIOR]


def _joined(found: Sequence[Registration], further: Registration) -> list[Registration]:
    """Add a registration: as a pose of its own, or in place of a worse one of the same pose."""
    same = [other for other in found if not is_distinct(further.T_target_source, [other.T_target_source])]
    if any(other.evidence >= further.evidence for other in same):
        return list(found)
    if any(not other.derivation for other in same):
        further = replace(further, derivation="")
    return [further, *(other for other in found if other not in same)]


def _competing_hypotheses(
    target: SensorView, source: SensorView, ranked: Sequence[Registration], gicp: FineConfig, config: CalibrationConfig
) -> list[tuple[Hypothesis, FineConfig]]:
    """Return poses that may score as well as the best, with their GICP: turned, repeated, or slid.

    A pose that only points in empty space speak against may be turned or slid from the true one. A pose of the prior
    is turned even if nothing speaks for it: a LiDAR may be drawn the wrong way round.

    Turned and repeated poses are off by less than a cell; slid ones, of a pose that is not well constrained, need the
    longest correspondence distance.
    """
    acceptance = config.acceptance
    max_baseline_m = acceptance.max_baseline_m
    if not ranked:
        return []
    best = ranked[0]
    uncontradicted = best.evidence + best.visibility.contradiction
    if cannot_be_accepted(uncontradicted, acceptance) and best.origin != PRIOR:
        return []
    near = gicp.model_copy(update={"max_correspondence_distances_m": gicp.max_correspondence_distances_m[1:]})
    start = _start_of(best)
    alike = alike_hypotheses(target.alone, source.alone, start, max_baseline_m, _MAX_SYMMETRIC_POSES)
    return [
        *_with(near, alike),
        *_with(gicp, _slides(best, _NEAR_SLIDE_M, config)),
    ]


def _start_of(found: Registration) -> Hypothesis:
    return Hypothesis(found.T_target_source, origin=found.origin, index=found.hypothesis)


def _slides(best: Registration, reach_m: float, config: CalibrationConfig) -> list[Hypothesis]:
    """Return poses along the weakest direction of a pose; none if it is well constrained, unless the place is long."""
    score = best.visibility
    if is_well_constrained(score, config.acceptance) and not is_in_long_place(score):
        return []
    steps = round(min(reach_m, _FARTHEST_SLIDE_M) / SLIDE_STEP_M)
    direction, max_baseline_m = score.slide_direction, config.acceptance.max_baseline_m
    return slid_hypotheses(_start_of(best), direction, max_baseline_m, steps)


def _far_slides(best: Registration, config: CalibrationConfig) -> list[Hypothesis]:
    """Return the slid poses beyond the near ones, as far as the largest baseline allows, the nearer ones first."""
    slides = _slides(best, 2.0 * config.acceptance.max_baseline_m, config)
    return [each for each in slides if best.T_target_source.distance_to(each.T_target_source)[0] > _NEAR_SLIDE_M + 0.5]


def _turned_slides(ranked: Sequence[Registration], config: CalibrationConfig) -> list[Hypothesis]:
    """Return the slid poses of the first pose that is turned against the best, if the place is long."""
    best, *others = ranked
    if not is_in_long_place(best.visibility):
        return []
    turned = [each for each in others if best.T_target_source.distance_to(each.T_target_source)[1] > _TURNED_RAD]
    return _slides(turned[0], 2.0 * config.acceptance.max_baseline_m, config) if turned else []


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


def _is_undecidable(ranked: Sequence[Registration], config: CalibrationConfig) -> bool:
    """Return whether so many poses surely compete with the first that no further one leads them all."""
    return len(ranked) > _SURELY_COMPETING and len(surely_competing(ranked, config.acceptance)) >= _SURELY_COMPETING


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
