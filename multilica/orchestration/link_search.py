# SPDX-License-Identifier: Apache-2.0
"""Search between the views of different stops of a drive, and registration where other pairs tell their poses."""

import time
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from multilica.acceptance.view_graph import ViewGraph
from multilica.config import CalibrationConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.orchestration.pairs import (
    PreparedLidar,
    SearchRequest,
    better_along_slide,
    priority_of,
    register_implied,
    register_roughly_implied,
    score_implied,
    score_roughly,
    search_pair,
)
from multilica.orchestration.stop_views import DriveStop, least_evidence, levels_of, prepare_views, with_movable
from multilica.registration.poses import is_distinct
from multilica.registration.widening import widened_along
from multilica.results import (
    DriveView,
    Hypothesis,
    PairKey,
    PairRegistration,
    Reason,
    Verdict,
    ViewPair,
)
from multilica.stages.pair_choice import LEAST_PRIORITY, choose_loops, next_round
from multilica.workers import Workers

# As many searches per view in a row that find nothing are enough; so are half as many the second time.
_FAILURES_PER_VIEW = 1.0
_RETRIES_PER_VIEW = 0.5
# Half as many are enough, too, once the poses of all LiDARs follow and further links only confirm them.
_FAILURES_IF_DETERMINED = 0.5
# So many promising pairs are all searched in some seconds, and each may be needed. Two LiDARs at four stops have so
# many in all: then also those that promise little.
_FEW_PAIRS = 24
# Each link needs another that confirms it. More improve poses that nothing but links tells.
_LOOPS_PER_VIEW, _LOOPS_IF_DETERMINED = 2, 1
# Beside links that tell a pose to decimetres, this sigma tells nothing.
_FREE_M = 1.0
# Half of the least turn that a drive needs between two stops.
_SAME_AXIS = float(np.cos(np.deg2rad(30.0)))


@dataclass(slots=True, eq=False)
class LinkSearch:
    """A search for links between the stops of a drive, and what it found so far.

    Args:
        stops: with prepared clouds.
        deadline_s: on `time.monotonic`.
        levels: poses of LiDARs over the ground; empty: not known yet.
        known: links of an earlier search, which are not registered again.
        links: by the labels of their views, as all below.
        weak: links with too little evidence to count alone.
        tested: pairs whose implied pose was tested.
        not_reached: pairs of stops for which there was no time.
        left_out: pairs that implied poses left with enough evidence, and that were not registered.
        searched: pairs that were searched without a pose.
    """

    stops: Sequence[DriveStop]
    config: CalibrationConfig
    workers: Workers
    deadline_s: float
    levels: Mapping[str, RigidTransform] = field(default_factory=dict)
    known: Sequence[ViewPair] = ()
    links: dict[PairKey, ViewPair] = field(default_factory=dict)
    weak: dict[PairKey, ViewPair] = field(default_factory=dict)
    tested: set[PairKey] = field(default_factory=set)
    not_reached: set[tuple[str, str]] = field(default_factory=set)
    left_out: set[PairKey] = field(default_factory=set)
    searched: dict[PairKey, PairRegistration | None] = field(default_factory=dict)
    loops_per_view: int = _LOOPS_PER_VIEW

    @property
    def _views(self) -> list[DriveView]:
        return [DriveView(lidar, stop.name) for stop in self.stops for lidar in stop.lidars]

    @property
    def _of_label(self) -> dict[str, DriveView]:
        return {view.label: view for view in self._views}

    @property
    def _between_stops(self) -> list[PairKey]:
        """All pairs of views of different stops without a known link, by their labels."""
        views, known = self._views, {link.views for link in self.known}
        return [
            (one.label, other.label)
            for number, one in enumerate(views)
            for other in views[number + 1 :]
            if one.stop != other.stop and frozenset((one, other)) not in known
        ]

    def _graph(self, motions: Sequence[ViewPair] = ()) -> ViewGraph:
        within = [ViewPair(pair, stop.name, stop.name) for stop in self.stops for pair in stop.pairs]
        known = [link for link in self.known if link.counts]
        return ViewGraph.of(self._views, [*within, *known, *self.links.values(), *motions])

    def run(self) -> None:
        """Search, then once more without what beams through movable objects prove, if the pose of a LiDAR is open."""
        views = self.share()
        if self._graph().is_determined:
            self.loops_per_view = _LOOPS_IF_DETERMINED
        pairs = self._between_stops
        found = zip(pairs, self.workers.map(priority_of, pairs), strict=True)
        least = 0.0 if len(pairs) <= _FEW_PAIRS else LEAST_PRIORITY
        priority = {pair: likely for pair, likely in found if likely >= least}
        self._search(priority, _FAILURES_PER_VIEW)
        if not self._graph().is_determined and (freed := with_movable(views, self.levels)):
            self._search_again(freed, priority)
        if self.loops_per_view > _LOOPS_IF_DETERMINED:
            self.tested -= self.left_out
            self._close_loops()
        self._doubt_slid()

    def _search_again(self, freed: Mapping[DriveView, PreparedLidar], priority: Mapping[PairKey, float]) -> None:
        """Search once more if beams through movable objects refused a pair: they prove nothing now.

        Args:
            freed: views whose beams through such objects prove nothing.
        """
        labels = {view.label for view in freed}
        self.workers.forget(labels)
        for view, prepared in freed.items():
            self.workers.share(view.label, prepared)
        before = len(self.searched), len(self.links)
        self.searched = {pair: each for pair, each in self.searched.items() if not _may_change(pair, each, labels)}
        self.tested.clear()
        self._close_loops()
        if (len(self.searched), len(self.links)) != before:
            self._search(priority, _RETRIES_PER_VIEW)

    def follow(self, motions: Sequence[ViewPair]) -> None:
        """Register pairs of views from the poses that motions imply, then from those that these links imply."""
        self.share()
        implied = self._implied(self._graph(motions))
        if self._is_late(implied):
            return
        self._register(implied, roughly=True)
        self._close_loops()
        self._doubt_slid()

    def follow_poses(self, poses: Mapping[DriveView, RigidTransform], lidars: Collection[str]) -> None:
        """Register pairs of views of some LiDARs from their poses, if beams agree."""
        of_label = self._of_label
        implied: dict[PairKey, RigidTransform] = {}
        for pair in self._between_stops:
            target, source = (of_label[label] for label in pair)
            if not {target, source} <= poses.keys():
                continue
            if target.lidar not in lidars and source.lidar not in lidars:
                continue
            if poses[target].target == poses[source].target:
                implied[pair] = poses[target].inverse() @ poses[source]
        if not implied or self._is_late(implied):
            return
        self.share()
        self.loops_per_view = len(of_label)
        self._register(implied, least_evidence(self.config), roughly=True, sliding=True)
        self._doubt_slid()

    def share(self) -> dict[DriveView, PreparedLidar]:
        """Prepare all views, and share them with the workers."""
        if not self.levels:
            self.levels = levels_of(self.stops, self.config)
        views = prepare_views(self.stops, self.levels, self.config)
        for view, prepared in views.items():
            self.workers.share(view.label, prepared)
        return views

    def _search(self, priority: Mapping[PairKey, float], per_view: float) -> None:
        labels = [view.label for view in self._views]
        tried: set[PairKey] = {*self.links, *self.searched}
        failures = 0
        while True:
            graph = self._graph()
            most = per_view * len(labels) if len(priority) > _FEW_PAIRS else _FEW_PAIRS
            if failures >= (min(most, _FAILURES_IF_DETERMINED * len(labels)) if graph.is_determined else most):
                break
            linked = [(graph.group_of(view).label, view.label) for view in self._views]
            pairs = next_round(labels, linked, tried, priority)
            if not pairs or self._is_late(pairs):
                break
            tried.update(pairs)
            before = len(self.links)
            self._search_now(pairs)
            self._close_loops()
            failures = 0 if len(self.links) > before else failures + len(pairs)

    def _search_now(self, pairs: Sequence[PairKey]) -> None:
        usual_m, deadline_s = self.config.features.voxel_size_m, self.deadline_s
        requests = [SearchRequest(pair, usual_m, deadline_s=deadline_s) for pair in pairs]
        for pair, search in zip(pairs, self.workers.map(search_pair, requests), strict=True):
            if search is None:
                self._miss([pair])
                continue
            self.searched[pair] = search.registration
            self._keep(pair, search.registration)

    def _is_late(self, pairs: Iterable[PairKey]) -> bool:
        """Return whether there is no time for pairs, and remember their stops then."""
        if time.monotonic() < self.deadline_s:
            return False
        self._miss(pairs)
        return True

    def _miss(self, pairs: Iterable[PairKey]) -> None:
        of_label = self._of_label
        self.not_reached |= {(of_label[one].stop, of_label[other].stop) for one, other in pairs}

    def _close_loops(self) -> None:
        """Register pairs of views from the poses that other pairs imply."""
        implied = {pair: pose for pair, pose in self._implied(self._graph()).items() if pair not in self.tested}
        if self._is_late(implied):
            return
        self.tested.update(implied)
        self.left_out |= self._register(implied)

    def _implied(self, graph: ViewGraph) -> dict[PairKey, RigidTransform]:
        of_label = self._of_label
        return {
            (target, source): pose
            for target, source in self._between_stops
            if (target, source) not in self.links
            if (pose := graph.implied(of_label[target], of_label[source])) is not None
        }

    def _register(
        self,
        implied: Mapping[PairKey, RigidTransform],
        least: float | None = None,
        *,
        roughly: bool = False,
        sliding: bool = False,
    ) -> set[PairKey]:
        """Register the most promising pairs from their poses; return the others that have enough evidence.

        Args:
            roughly: the poses may be some decimetres off.
            sliding: also keep those that slide, as weak links that tell nothing along that direction.
        """
        score, register = (score_roughly, register_roughly_implied) if roughly else (score_implied, register_implied)
        scores = dict(zip(implied, self.workers.map(score, list(implied.values())), strict=True))
        least = self.config.acceptance.min_evidence if least is None else least
        chosen = choose_loops(scores, least, self.loops_per_view)
        starts = [Hypothesis(implied[pair]) for pair in chosen]
        for pair, found in zip(chosen, self.workers.map(register, starts), strict=True):
            if not is_distinct(implied[pair], [found.T_target_source.with_target(pair[0])]):
                self._keep(pair, _without_slide(found) if sliding else found)
        return {pair for pair in scores.keys() - chosen if scores[pair].evidence >= least}

    def _doubt_slid(self) -> None:
        """Leave links of two LiDARs undecided if a place farther along the way fits one of them better.

        Along a rail with posts, links follow from a wrong one and fit like it, but not always best. So all links go
        that slide the same way on the vehicle. After a turn they slide another way, and would contradict a wrong one.
        """
        between = {pair: link for pair, link in self.links.items() if len(link.registration.lidars) > 1}
        found = [link.registration.registrations[0] for link in between.values()]
        better = zip(between, self.workers.map(better_along_slide, found), strict=True)
        leads = {pair: other for pair, other in better if other is not None}
        for pair in sorted(leads, key=leads.__getitem__, reverse=True):
            lead, away_m = leads[pair]
            one, other = sorted(between[pair].registration.lidars)
            text = f"a place {away_m:.1f} m along the way fits links of {one} with {other} better"
            verdict = Verdict("undecided", (Reason("held_by_repetition", lead, 0.0, text),))
            for also, link in between.items():
                if _slide_alike(between[pair], link):
                    self.links[also] = replace(link, registration=replace(link.registration, verdict=verdict))

    def _keep(self, pair: PairKey, found: PairRegistration | None) -> None:
        if found is None or not found.verdict.counts or found.information is None:
            return
        target, source = self._of_label[found.target], self._of_label[found.source]
        pose = RigidTransform(target.lidar, source.lidar, found.T_target_source.matrix)
        of_lidars = replace(found, target=target.lidar, source=source.lidar, T_target_source=pose)
        is_weak = found.evidence < self.config.acceptance.min_evidence or "not_observable" in found.verdict.codes
        (self.weak if is_weak else self.links)[pair] = ViewPair(of_lidars, target.stop, source.stop)


def _without_slide(found: PairRegistration) -> PairRegistration:
    """Return a registration that is refused only because it slides as an uncertain one without that direction."""
    if found.verdict.codes != ("not_observable",):
        return found
    freed = widened_along(found, found.registrations[0].visibility.weakest_direction, _FREE_M)
    return replace(freed, verdict=Verdict("uncertain", found.verdict.reasons))


def _slide_alike(one: ViewPair, other: ViewPair) -> bool:
    """Return whether two links are of the same LiDARs, and slide along the same axis as seen from each of them."""
    axes, others = _slide_axes(one), _slide_axes(other)
    if axes.keys() != others.keys():
        return False
    return all(abs(float(axis @ others[lidar])) > _SAME_AXIS for lidar, axis in axes.items())


def _slide_axes(link: ViewPair) -> dict[str, FloatArray]:
    """Return the axis along which a link slides, in the frame of each of its two LiDARs."""
    axis = link.registration.registrations[0].visibility.slide_direction
    return {link.target.lidar: axis, link.source.lidar: link.registration.T_target_source.rotation.T @ axis}


def _may_change(pair: PairKey, found: PairRegistration | None, freed: Collection[str]) -> bool:
    """Return whether another search may find the pair once beams through movable objects of some views prove nothing.

    Only beams that found its space empty depend on these objects. A pose that was undecided has enough evidence, and
    fewer beams against its competitors do not decide it.
    """
    if found is None or found.verdict.outcome != "reject" or "empty_space_violated" not in found.verdict.codes:
        return False
    return any(label in freed for label in pair)
