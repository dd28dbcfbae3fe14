# SPDX-License-Identifier: Apache-2.0
"""Search for registrations between the stops of a drive."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from multilica.acceptance.view_graph import ViewGraph
from multilica.config import CalibrationConfig
from multilica.geometry import RigidTransform
from multilica.orchestration.pairs import (
    PreparedLidar,
    SearchRequest,
    priority_of,
    register_implied,
    score_implied,
    search_pair,
)
from multilica.registration.poses import is_distinct
from multilica.results import DriveView, Hypothesis, PairKey, PairRegistration, ViewPair
from multilica.stages.pair_choice import choose_loops, next_round
from multilica.workers import Workers

MAX_LINKED_STOPS = 8
"""Prepared clouds of more stops take much memory, and all their pairs much time."""

# Matches that agree by chance in views without anything in common; below, one search of ten finds a pose.
_LEAST_PRIORITY = 6.0
# Per view: beyond, searches find little.
_SEARCHES_PER_VIEW = 3
# Each link needs another that confirms it; more hardly improve the poses.
_LOOPS_PER_VIEW = 2


@dataclass(frozen=True, slots=True, eq=False)
class DriveStop:
    """A stop after its own calibration.

    Args:
        lidars: those with returns in range.
        pairs: the registrations that its poses rest on.
    """

    name: str
    lidars: Mapping[str, PreparedLidar]
    pairs: tuple[PairRegistration, ...]


def search_links(
    stops: Sequence[DriveStop], config: CalibrationConfig, workers: Workers, deadline_s: float = float("inf")
) -> tuple[ViewPair, ...]:
    """Register views of different stops, the most promising first, until they are linked or nothing promising is left.

    A pair whose pose follows from others is not searched: the beams test that pose, and it is registered from there.
    So most links have others that confirm them.

    Returns:
        The accepted and the uncertain registrations, none of which is confirmed.
    """
    if config.drive.max_distance_m == 0.0 or not config.verify.enabled or len(stops) < 2:
        return ()
    search = _LinkSearch(stops[:MAX_LINKED_STOPS], config, workers, deadline_s)
    workers.forget()
    for view in search.views:
        workers.share(view.label, search.prepared(view))
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

    def prepared(self, view: DriveView) -> PreparedLidar:
        """Return a LiDAR with the limits that hold between stops."""
        config = self.config
        acceptance = config.acceptance.model_copy(update={"max_baseline_m": config.drive.max_distance_m})
        sigmas_m = config.refine.range_bias_sigmas_m
        own = {view.label: sigmas_m[view.lidar]} if view.lidar in sigmas_m else {}
        refine = config.refine.model_copy(update={"range_bias_sigmas_m": own | sigmas_m})
        stop = next(stop for stop in self.stops if stop.name == view.stop)
        limits = config.model_copy(update={"acceptance": acceptance, "refine": refine})
        return stop.lidars[view.lidar].as_view(view.label, limits)

    def graph(self) -> ViewGraph:
        within = [ViewPair(pair, stop.name, stop.name) for stop in self.stops for pair in stop.pairs]
        return ViewGraph.of(self.views, [*within, *self.links.values()])

    def run(self) -> None:
        """Search with the usual descriptors, then with others as long as the pose of a LiDAR does not follow."""
        pairs, usual = self.between_stops, self.config.features
        found = zip(pairs, self.workers.map(priority_of, pairs), strict=True)
        priority = {pair: likely for pair, likely in found if likely >= _LEAST_PRIORITY}
        for voxel_size_m in (usual.voxel_size_m, *usual.retry_voxel_sizes_m):
            self._search(priority, voxel_size_m)
            if self.graph().is_determined:
                break

    def _search(self, priority: Mapping[PairKey, float], voxel_size_m: float) -> None:
        labels = [view.label for view in self.views]
        tried: set[PairKey] = {*self.links}
        while len(tried) < _SEARCHES_PER_VIEW * len(labels) and time.monotonic() < self.deadline_s:
            graph = self.graph()
            linked = [(graph.group_of(view).label, view.label) for view in self.views]
            pairs = next_round(labels, linked, tried, priority)
            if not pairs:
                break
            tried.update(pairs)
            requests = [SearchRequest(pair, voxel_size_m) for pair in pairs]
            for pair, search in zip(pairs, self.workers.map(search_pair, requests), strict=True):
                self._keep(pair, search.registration)
            self._close_loops()

    def _close_loops(self) -> None:
        """Register pairs of views from the poses that other pairs imply."""
        graph, of_label = self.graph(), self.of_label
        implied = {
            (target, source): pose
            for target, source in self.between_stops
            if (target, source) not in self.tested and (target, source) not in self.links
            if (pose := graph.implied(of_label[target], of_label[source])) is not None
        }
        self.tested.update(implied)
        scores = dict(zip(implied, self.workers.map(score_implied, list(implied.values())), strict=True))
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
