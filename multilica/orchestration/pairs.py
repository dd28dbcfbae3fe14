# SPDX-License-Identifier: Apache-2.0
"""LiDARs prepared for the stages of pairs, and search and registration of single pairs, as tasks for workers."""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from multilica.acceptance.accept import (
    accept,
    accept_by_fitness,
    is_surely_ambiguous,
    may_be_accepted,
    surely_competing,
)
from multilica.acceptance.placement import unknown_precision
from multilica.config import CalibrationConfig, Stage
from multilica.geometry import RigidTransform
from multilica.registration.gicp import prepare_gicp_cloud
from multilica.registration.poses import is_distinct, moved
from multilica.results import (
    CoarseResult,
    Correspondences,
    FeatureCloud,
    Hypothesis,
    PairKey,
    PairRegistration,
    PreprocessedCloud,
    Registration,
    Verdict,
)
from multilica.stages.coarse import find_hypotheses
from multilica.stages.correspond import match_features, pair_priority
from multilica.stages.features import compute_features
from multilica.stages.fine import register_best
from multilica.stages.verify import VerificationCloud, find_poses_beside, short_gicp, verify_hypotheses
from multilica.time_limit import OutOfTime, require_time, time_until
from multilica.visibility.plans import shifted_poses
from multilica.visibility.registration_cloud import RegistrationCloud, prepare_registration_cloud
from multilica.visibility.sensor_view import (
    FINE_TOLERANCES,
    ROUGH_TOLERANCES,
    SensorView,
    may_compete,
    prepare_sensor_view,
    score_pose,
)
from multilica.workers import Shared

# Poses nearer along a slide may be the same one with a large sigma.
_NEXT_PLACE_M = 2.0
# A pose that is wrong by more puts LiDARs of most vehicles too far apart.
_LONGEST_SLIDE_M = 15.0
# Rough tolerances reach half of it to both sides.
_SCORED_STEP_M = 0.3

# So many that at least two of them compete after the fine registration too.
_ENOUGH_COMPETING = 4

PAIR_STAGES: tuple[Stage, ...] = ("correspond", "coarse", "verify", "fine")


@dataclass(frozen=True, eq=False)
class PreparedLidar:
    """Data that all searches and registrations of one LiDAR share; clouds for GICP are built on first use.

    Args:
        cloud: its points; the returns are left out.
        features: descriptors on the usual voxel grid.
        view: None where verification is off.
    """

    cloud: PreprocessedCloud
    features: FeatureCloud
    view: SensorView | None
    config: CalibrationConfig
    _features: dict[float, FeatureCloud] = field(default_factory=dict)

    def features_at(self, voxel_size_m: float) -> FeatureCloud:
        """Return the descriptors on a voxel grid of that size."""
        usual = self.config.features
        if voxel_size_m == usual.voxel_size_m:
            return self.features
        if voxel_size_m not in self._features:
            of_size = usual.model_copy(update={"voxel_size_m": voxel_size_m})
            self._features[voxel_size_m] = compute_features(self.cloud, of_size)
        return self._features[voxel_size_m]

    @cached_property
    def verification_cloud(self) -> VerificationCloud:
        """The LiDAR as one side of a short GICP; only where verification is on."""
        assert self.view is not None  # noqa: S101
        gicp = short_gicp(self.config.fine)
        cloud = self.cloud
        return VerificationCloud(self.view, prepare_gicp_cloud(cloud.lidar, cloud.points_m, gicp, cloud.elevation_axis))

    @cached_property
    def side(self) -> RegistrationCloud:
        """The LiDAR as one side of a fine registration."""
        views = [] if self.view is None else self.view.alone
        cloud = self.cloud
        return prepare_registration_cloud(cloud.lidar, cloud.points_m, views, self.config, cloud.elevation_axis)

    def with_view(self, view: SensorView) -> "PreparedLidar":
        """Return the LiDAR with another view of the same points, with the clouds that were built so far."""
        found = replace(self, view=view)
        if "verification_cloud" in self.__dict__:
            found.__dict__["verification_cloud"] = VerificationCloud(view, self.verification_cloud.cloud)
        if "side" in self.__dict__:
            found.__dict__["side"] = replace(self.side, views=tuple(view.alone))
        return found

    def as_view(self, label: str, config: CalibrationConfig) -> "PreparedLidar":
        """Return the LiDAR as a view at a stop, under another name, with the clouds that were built so far."""
        view = None if self.view is None else replace(self.view, lidar=label, at_stop=True)
        cloud, features = replace(self.cloud, lidar=label), replace(self.features, lidar=label)
        found = PreparedLidar(cloud, features, view, config)
        if view is not None and "verification_cloud" in self.__dict__:
            short = VerificationCloud(view, replace(self.verification_cloud.cloud, name=label))
            found.__dict__["verification_cloud"] = short
        if view is not None and "side" in self.__dict__:
            found.__dict__["side"] = replace(
                self.side, cloud=replace(self.side.cloud, name=label), views=tuple(view.alone)
            )
        return found

    def __reduce__(self) -> tuple[object, ...]:
        """Leave out what is built on first use: types of the engines cannot be copied to another process."""
        return PreparedLidar, (self.cloud, self.features, self.view, self.config)


def prepare_lidar(cloud: PreprocessedCloud, config: CalibrationConfig, *, described: bool = True) -> PreparedLidar:
    """Compute the descriptors of a LiDAR, if they are wanted, and its view if verification is on."""
    features = compute_features(cloud if described else replace(cloud, points_m=np.empty((0, 3))), config.features)
    view = prepare_sensor_view(cloud) if config.verify.enabled else None
    slim = replace(cloud, returns_m=np.empty((0, 3), np.float32), dropped_m={}, left_out=cloud.returns)
    return PreparedLidar(slim, features, view, config)


@dataclass(frozen=True, slots=True)
class SearchRequest:
    """A pair to search.

    Args:
        voxel_size_m: of the descriptors.
        prior: a pose that is known beforehand.
        until: the last stage to run, one of `PAIR_STAGES`.
        refused: poses of an earlier search of the pair. Then only an accepted registration counts, and the search ends
            where there will be none.
        deadline_s: on `time.monotonic`, at which the search ends.
    """

    pair: PairKey
    voxel_size_m: float
    prior: RigidTransform | None = None
    until: Stage = "fine"
    refused: tuple[RigidTransform, ...] | None = None
    deadline_s: float = math.inf


@dataclass(slots=True, eq=False)
class PairSearch:
    """Results of the stages for a pair, up to the last stage that ran.

    Args:
        verified: None where verification is off.
        registration: None if there is no hypothesis.
        elapsed_s: of each stage.
    """

    matches: Correspondences
    coarse: CoarseResult | None = None
    verified: tuple[Registration, ...] | None = None
    registration: PairRegistration | None = None
    elapsed_s: dict[Stage, float] = field(default_factory=dict)


def priority_of(lidars: Shared, pair: PairKey) -> float:
    """Estimate how likely a search of the pair succeeds."""
    target, source = (lidars[name] for name in pair)
    config = target.config
    return pair_priority(target.features, source.features, config.coarse, config.acceptance.max_baseline_m)


def search_pair(lidars: Shared | Mapping[str, PreparedLidar], request: SearchRequest) -> PairSearch | None:
    """Search the pose of a pair without an initial guess: match, find hypotheses, verify them, register the best.

    Returns:
        The results; None if the deadline ended the search.
    """
    try:
        with time_until(request.deadline_s):
            require_time()
            return _search_in_stages(lidars, request)
    except OutOfTime:
        return None


def _search_in_stages(lidars: Shared | Mapping[str, PreparedLidar], request: SearchRequest) -> PairSearch:
    target, source = (lidars[name] for name in request.pair)
    config = target.config
    stages = PAIR_STAGES[: PAIR_STAGES.index(request.until) + 1]
    start_s = time.perf_counter()

    def finish(stage: Stage) -> None:
        found.elapsed_s[stage] = time.perf_counter() - start_s - sum(found.elapsed_s.values())

    of_target, of_source = (each.features_at(request.voxel_size_m) for each in (target, source))
    found = PairSearch(match_features(of_target, of_source, config.correspond))
    finish("correspond")
    if "coarse" in stages:
        limits = config.coarse, config.acceptance.max_baseline_m
        found.coarse = find_hypotheses(found.matches, *limits, request.prior)
        finish("coarse")
    if "verify" in stages and found.coarse is not None and config.verify.enabled:
        sides = target.verification_cloud, source.verification_cloud
        found.verified = verify_hypotheses(*sides, found.coarse, config, request.refused)
        finish("verify")
    if (
        request.refused is not None
        and found.verified is not None
        and not may_be_accepted(found.verified, config.acceptance)
    ):
        return found
    if "fine" in stages and found.coarse is not None:
        if found.verified is None and found.coarse.hypotheses:
            found.registration = register_sides(target.side, source.side, found.coarse.hypotheses, config)
        elif found.verified:
            found.registration = _register_verified(target.side, source.side, found.verified, config)
        _beside_further_poses(found, target, source)
        finish("fine")
    return found


def _register_verified(
    target: RegistrationCloud, source: RegistrationCloud, verified: Sequence[Registration], config: CalibrationConfig
) -> PairRegistration:
    """Register the verified poses of a pair; if several surely compete with the first, these alone tell that."""
    competing = sorted(surely_competing(verified, config.acceptance), key=verified[0].lead_over)
    if len(competing) >= _ENOUGH_COMPETING:
        few = [each.as_hypothesis(verified[0]) for each in (verified[0], *competing[:_ENOUGH_COMPETING])]
        found = register_sides(target, source, few, config)
        if found.verdict.outcome == "undecided":
            return found
    return register_sides(target, source, [each.as_hypothesis(verified[0]) for each in verified], config)


def _beside_further_poses(search: PairSearch, target: PreparedLidar, source: PreparedLidar) -> None:
    """Register a pair that counts once more, beside poses that may compete with it and were not verified.

    On a vehicle there are none beside the pose that led after the verification.
    """
    registration, config = search.registration, target.config
    if not search.verified or registration is None or not registration.verdict.counts:
        return
    name, views = target.side.cloud.name, (target.verification_cloud, source.verification_cloud)
    led = not is_distinct(search.verified[0].T_target_source, [registration.T_target_source.with_target(name)])
    led = led and not is_surely_ambiguous(search.verified, config.acceptance)
    if led and not views[0].view.at_stop:
        return
    further = find_poses_beside(*views, registration, config, led=led)
    if further:
        best = registration.registrations[0]
        poses = [each.as_hypothesis(best) for each in (best, *further)]
        poses = [replace(each, T_target_source=each.T_target_source.with_target(name)) for each in poses]
        found = register_sides(target.side, source.side, poses, config)
        search.registration = _with_poses(found, registration.registrations[1:], config)
        search.verified = (*search.verified, *further)


def _with_poses(found: PairRegistration, others: Sequence[Registration], config: CalibrationConfig) -> PairRegistration:
    """Return a registration with the further poses of an earlier one of the same sides, which count in the verdict."""
    poses = [each.T_target_source for each in found.registrations]
    further = [each for each in others if is_distinct(each.T_target_source, poses)]
    best, *rest = found.registrations
    ranked = (best, *sorted((*rest, *further), key=lambda each: -each.evidence))
    return replace(found, registrations=ranked, verdict=accept(ranked, config.acceptance))


def register_implied(lidars: Shared, implied: Hypothesis) -> PairRegistration:
    """Register two LiDARs from the pose that other pairs imply, by a fit to planes alone if that hardly moves it."""
    return _register_from(lidars, implied, is_known=True)


def register_roughly_implied(lidars: Shared, implied: Hypothesis) -> PairRegistration:
    """Register two LiDARs from an implied pose that may be some decimetres off."""
    return _register_from(lidars, implied, is_known=False)


def _register_from(lidars: Shared, start: Hypothesis, *, is_known: bool) -> PairRegistration:
    pose = start.T_target_source
    target, source = (lidars[name] for name in (pose.target, pose.source))
    return register_sides(target.side, source.side, [start], target.config, is_known=is_known)


def score_implied(lidars: Shared, pose: RigidTransform) -> Registration:
    """Score a pose between two LiDARs by their beams."""
    target, source = (lidars[name].view for name in (pose.target, pose.source))
    return score_pose(target, source, pose, *FINE_TOLERANCES)


def score_roughly(lidars: Shared, pose: RigidTransform) -> Registration:
    """Score a pose between two LiDARs that may be some centimetres off by their beams."""
    target, source = (lidars[name].view for name in (pose.target, pose.source))
    return score_pose(target, source, pose, *ROUGH_TOLERANCES)


def better_along_slide(lidars: Shared, found: Registration) -> tuple[float, float] | None:
    """Find a pose that beams prefer to a registered one, along its weakest direction and too far away to be the same.

    The likeliest that seems better is registered, because poses some decimetres off compare roughly.

    Returns:
        The lead of the registered pose over it, which is negative, and how far it is; None if no pose is better.
    """
    pose, direction = found.T_target_source, found.visibility.slide_direction
    target, source = (lidars[name].view for name in (pose.target, pose.source))
    known = score_roughly(lidars, pose)
    ways_m = np.arange(_NEXT_PLACE_M, _LONGEST_SLIDE_M, _SCORED_STEP_M)
    shifted = [moved(pose, np.zeros(3), side * way_m * direction) for way_m in ways_m for side in (1.0, -1.0)]
    better = [
        score_roughly(lidars, each)
        for each in shifted
        if may_compete(target, source, each, known, known.evidence, *ROUGH_TOLERANCES)
    ]
    if not better:
        return None
    likeliest = min(better, key=known.rough_lead_over)
    best = register_roughly_implied(lidars, Hypothesis(likeliest.T_target_source)).registrations[0]
    lead = found.lead_over(best) if is_distinct(best.T_target_source, [pose]) else 0.0
    return (lead, best.T_target_source.distance_to(pose)[0]) if lead < 0.0 else None


def lead_over_shifts(lidars: Shared, found: Registration) -> float:
    """Compare a pose by beams with those at which the plans of both LiDARs coincide after a shift.

    Returns:
        By how much it is likelier than the likeliest of them, negative if it is less likely, or if no plan tells.
    """
    pose = found.T_target_source
    target, source = (lidars[name] for name in (pose.target, pose.source))
    if target.view is None or source.view is None:
        return -math.inf
    shifted = shifted_poses(target.view.alone, source.view.alone, pose, target.config.acceptance.max_baseline_m)
    if shifted is None:
        return -math.inf
    known = score_roughly(lidars, pose)
    return min((known.rough_lead_over(score_roughly(lidars, each)) for each in shifted), default=math.inf)


def register_sides(
    target: RegistrationCloud,
    source: RegistrationCloud,
    hypotheses: Sequence[Hypothesis],
    config: CalibrationConfig,
    *,
    fit: bool = True,
    is_known: bool = False,
) -> PairRegistration:
    """Register two sides as `register_best` does, with a verdict."""
    found = register_best(target, source, hypotheses, config, fit=fit, is_known=is_known)
    if found.registrations:
        views = max(len(target.views), len(source.views))
        verdict = accept(found.registrations, config.acceptance, views)
        if fit and found.information is None and verdict.counts:
            verdict = Verdict("undecided", (unknown_precision(config.acceptance),))
        return replace(found, verdict=verdict)
    return replace(found, verdict=accept_by_fitness(found, config.merge))
