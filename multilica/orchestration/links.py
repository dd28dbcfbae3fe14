# SPDX-License-Identifier: Apache-2.0
"""Search for registrations between the stops of a drive."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from multilica.acceptance.view_graph import ViewGraph
from multilica.config import CalibrationConfig
from multilica.geometry import RigidTransform
from multilica.orchestration.pairs import (
    SearchRequest,
    priority_of,
    register_implied,
    score_implied,
    score_roughly,
    search_pair,
)
from multilica.orchestration.stop_views import DriveStop, prepare_views
from multilica.registration.poses import is_distinct
from multilica.results import DriveView, Hypothesis, PairKey, PairRegistration, Registration, ViewPair
from multilica.stages.pair_choice import choose_loops, next_round
from multilica.workers import Shared, Workers

MAX_LINKED_STOPS = 8
"""Prepared clouds of more stops take much memory, and all their pairs much time."""

# Matches that agree by chance in views without anything in common; below, one search of ten finds a pose.
_LEAST_PRIORITY = 6.0
# As many searches per view in a row that find nothing are enough; so are half as many the second time.
_FAILURES_PER_VIEW = 1.0
_RETRIES_PER_VIEW = 0.5
# Each link needs another that confirms it; more hardly improve the poses.
_LOOPS_PER_VIEW = 2


def search_links(
    stops: Sequence[DriveStop],
    config: CalibrationConfig,
    workers: Workers,
    deadline_s: float = float("inf"),
    motions: Sequence[ViewPair] = (),
) -> tuple[ViewPair, ...]:
    """Register views of different stops, the most promising first, until they are linked or nothing promising is left.

    A pair whose pose follows from others is not searched: the beams test that pose, and it is registered from there.
    So most links have others that confirm them.

    Args:
        motions: of LiDARs between the stops by odometry. Pairs whose pose follows from them are tested first.

    Returns:
        The accepted and the uncertain registrations, none of which is confirmed.
    """
    if config.drive.max_distance_m == 0.0 or not config.verify.enabled or len(stops) < 2:
        return ()
    search = _LinkSearch(stops[:MAX_LINKED_STOPS], config, workers, deadline_s, motions)
    try:
        search.run()
    finally:
        workers.forget()
    return tuple(search.links.values())


@dataclass(slots=True, eq=False)
class _LinkSearch:
    stops: Sequence[DriveStop]
    config: CalibrationConfig
    workers: Workers
    deadline_s: float
    motions: Sequence[ViewPair] = ()
    links: dict[PairKey, ViewPair] = field(default_factory=dict)
    tested: set[PairKey] = field(default_factory=set)

    @property
    def views(self) -> list[DriveView]:
        return [DriveView(lidar, stop.name) for stop in self.stops for lidar in stop.lidars]

    @property
    def of_label(self) -> dict[str, DriveView]:
        return {view.label: view for view in self.views}

    @property
    def between_stops(self) -> list[PairKey]:
        """All pairs of views of different stops, by their labels."""
        views = self.views
        return [
            (one.label, other.label)
            for number, one in enumerate(views)
            for other in views[number + 1 :]
            if one.stop != other.stop
        ]

    def graph(self, motions: Sequence[ViewPair] = ()) -> ViewGraph:
        within = [ViewPair(pair, stop.name, stop.name) for stop in self.stops for pair in stop.pairs]
        return ViewGraph.of(self.views, [*within, *self.links.values(), *motions])

    def run(self) -> None:
        """Search, then once more without what beams through movable objects prove, if the pose of a LiDAR is open."""
        self._share(movable=False)
        self._start_from_motions()
        pairs = self.between_stops
        found = zip(pairs, self.workers.map(priority_of, pairs), strict=True)
        priority = {pair: likely for pair, likely in found if likely >= _LEAST_PRIORITY}
        self._search(priority, _FAILURES_PER_VIEW)
        if not self.graph().is_determined:
            self._share(movable=True)
            self.tested.clear()
            self._start_from_motions()
            self._close_loops()
            self._search(priority, _RETRIES_PER_VIEW)

    def _share(self, *, movable: bool) -> None:
        self.workers.forget()
        for view, prepared in prepare_views(self.stops, self.config, movable=movable).items():
            self.workers.share(view.label, prepared)

    def _search(self, priority: Mapping[PairKey, float], per_view: float) -> None:
        labels = [view.label for view in self.views]
        tried: set[PairKey] = {*self.links}
        failures = 0
        while failures < per_view * len(labels) and time.monotonic() < self.deadline_s:
            graph = self.graph()
            linked = [(graph.group_of(view).label, view.label) for view in self.views]
            pairs = next_round(labels, linked, tried, priority)
            if not pairs:
                break
            tried.update(pairs)
            requests = [SearchRequest(pair, self.config.features.voxel_size_m) for pair in pairs]
            before = len(self.links)
            for pair, search in zip(pairs, self.workers.map(search_pair, requests), strict=True):
                self._keep(pair, search.registration)
            self._close_loops()
            failures = 0 if len(self.links) > before else failures + len(pairs)

    def _start_from_motions(self) -> None:
        """Register pairs of views from the poses that motions imply; what does not fit there is searched later."""
        if self.motions:
            self._register(self._implied(self.graph(self.motions)), score_roughly)

    def _close_loops(self) -> None:
        """Register pairs of views from the poses that other pairs imply."""
        implied = {pair: pose for pair, pose in self._implied(self.graph()).items() if pair not in self.tested}
        self.tested.update(implied)
        self._register(implied, score_implied)

    def _implied(self, graph: ViewGraph) -> dict[PairKey, RigidTransform]:
        of_label = self.of_label
        return {
            (target, source): pose
            for target, source in self.between_stops
            if (target, source) not in self.links
            if (pose := graph.implied(of_label[target], of_label[source])) is not None
        }

    def _register(
        self, implied: Mapping[PairKey, RigidTransform], score: Callable[[Shared, RigidTransform], Registration]
    ) -> None:
        scores = dict(zip(implied, self.workers.map(score, list(implied.values())), strict=True))
        chosen = choose_loops(scores, self.config.acceptance.min_evidence, _LOOPS_PER_VIEW)
        starts = [Hypothesis(implied[pair]) for pair in chosen]
        for pair, found in zip(chosen, self.workers.map(register_implied, starts), strict=True):
            if not is_distinct(implied[pair], [found.T_target_source.with_target(pair[0])]):
                self._keep(pair, found)

    def _keep(self, pair: PairKey, found: PairRegistration | None) -> None:
        if found is None or found.verdict.outcome not in ("accept", "uncertain") or found.information is None:
            return
        target, source = self.of_label[found.target], self.of_label[found.source]
        pose = RigidTransform(target.lidar, source.lidar, found.T_target_source.matrix)
        of_lidars = replace(found, target=target.lidar, source=source.lidar, T_target_source=pose)
        self.links[pair] = ViewPair(of_lidars, target.stop, source.stop)
