# SPDX-License-Identifier: Apache-2.0
"""Calibration of a rig from several stops of one drive."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from math import inf
from types import MappingProxyType
from typing import Literal

from threadpoolctl import threadpool_limits

from multilica import events
from multilica.config import CalibrationConfig
from multilica.errors import UnfitSnapshotError, UsageError
from multilica.events import Observer
from multilica.geometry import RigidTransform
from multilica.multi_snapshot.common_ground import ground_pairs
from multilica.multi_snapshot.join import join, require_joinable
from multilica.multi_snapshot.motions import OPEN_M
from multilica.multi_snapshot.snapshot_run import SnapshotRun
from multilica.multi_snapshot.view_solution import solutions_on_plane, solve_views
from multilica.multi_snapshot.weak_links import confirmed_links
from multilica.orchestration import open_calibration_workers
from multilica.orchestration.clouds import without_blind_target
from multilica.orchestration.earlier_stops import EarlierStops
from multilica.orchestration.links import (
    MAX_LINKED_STOPS,
    FoundLinks,
    follow_motions,
    follow_poses,
    mark_unique,
    search_links,
)
from multilica.orchestration.pairs import PreparedLidar
from multilica.orchestration.state import deadline_of
from multilica.orchestration.stop_beams import contradiction_at, lead_at
from multilica.orchestration.stop_views import DriveStop
from multilica.pipeline import calibrate
from multilica.registration.motions import motion_pairs
from multilica.registration.poses import is_near
from multilica.registration.widening import loosened
from multilica.results import CalibrationResult, DriveView, LidarPlacement, TimeLimit, ViewPair
from multilica.results.registrations import weakest_deviations
from multilica.snapshot import LidarMotion, ReadMotions, Snapshot
from multilica.workers import Workers

CalibrateAlone = Callable[[dict[str, PreparedLidar] | None, EarlierStops], SnapshotRun]
"""Calibrates one stop; called with a dictionary to keep its prepared LiDARs in, or None, and the earlier stops."""


# Few surfaces hold a link with little evidence, and some of its matches are by chance: one was 6 sigma off.
_WEAKER = 2.0
# So many solutions of all links are told apart by the beams: each turns some LiDARs by half a turn.
_MOST_SOLUTIONS = 8


@dataclass(frozen=True, slots=True, eq=False)
class DriveCalibration:
    """A joint result, the stops between which links were sought, and the links that were found."""

    result: CalibrationResult
    stops: tuple[DriveStop, ...]
    links: tuple[ViewPair, ...]


def wanted_stops(config: CalibrationConfig) -> int | Literal["auto"]:
    """Return `drive.stops`, or 1 in place of "auto" if no joint result is possible with this configuration."""
    if config.drive.stops == "auto":
        try:
            require_joinable(config)
        except UsageError:
            return 1
    return config.drive.stops


def calibrate_stops(
    snapshots: Sequence[Snapshot],
    config: CalibrationConfig | None = None,
    observe: Observer = events.ignore,
    workers: Workers | None = None,
    deadline_s: float | None = None,
) -> CalibrationResult:
    """Find the pose of every LiDAR from several stops of one vehicle.

    Each stop is calibrated, from the poses of earlier ones where they hold. Then views of different stops are
    registered, so that a LiDAR may be placed by what another one saw of the same place at another stop. All stops count
    in one estimate at the end.

    Args:
        snapshots: with the same LiDARs; those of different places are joined without links.
        observe: called with the events of each stop.
    """
    config = config or CalibrationConfig()
    require_joinable(config)
    deadline_s = deadline_of(config) if deadline_s is None else deadline_s
    if workers is None:
        with open_calibration_workers(config) as opened:
            return calibrate_stops(snapshots, config, observe, opened, deadline_s)
    alone = {
        f"stop {number}": partial(calibrate_alone, f"stop {number}", snapshot, config, observe, workers, deadline_s)
        for number, snapshot in enumerate(snapshots, start=1)
    }
    ways = ways_of({f"stop {number}": snapshot for number, snapshot in enumerate(snapshots, start=1)})
    return calibrate_jointly(alone, config, workers, deadline_s, ways).result


def calibrate_jointly(
    alone: Mapping[str, CalibrateAlone],
    config: CalibrationConfig,
    workers: Workers,
    deadline_s: float,
    ways: Mapping[str, ReadMotions] = MappingProxyType({}),
) -> DriveCalibration:
    """Calibrate each stop, register views of different stops, and join all of it.

    Args:
        alone: by the name of the stop, in the order of the drive.
        ways: by the name of the stop, to read the motions since the one before. They are read only if links leave the
            pose of a LiDAR open, and none is begun later than the deadline.
    """
    not_followed: list[tuple[str, str]] = []

    def read_motions() -> tuple[ViewPair, ...]:
        legs: list[tuple[str, tuple[LidarMotion, ...]]] = []
        for number, run in enumerate(runs):
            way = ways.get(run.name)
            if way is not None and time.monotonic() >= deadline_s:
                not_followed.append((runs[number - 1].name, run.name))
                way = None
            legs.append((run.name, () if way is None else way()))
        return motion_pairs(legs, {stop.name for stop in stops})

    runs: list[SnapshotRun] = []
    stops: list[DriveStop] = []
    for name, calibrate_stop in alone.items():
        prepared: dict[str, PreparedLidar] | None = {} if len(stops) < MAX_LINKED_STOPS else None
        earlier = EarlierStops.of([run.result for run in runs if run.result is not None])
        runs.append(calibrate_stop(prepared, earlier))
        if prepared and (own := runs[-1].result) is not None:
            stops.append(DriveStop(name, prepared, own.trusted))
    found, result = _link(stops, runs, config, workers, read_motions, deadline_s)
    if not_reached := {*found.not_reached, *not_followed}:
        limit = result.time_limit or TimeLimit(config.runtime.max_time_s, ())
        result = replace(result, time_limit=replace(limit, unlinked_stops=tuple(sorted(not_reached))))
    return DriveCalibration(result, tuple(stops), found.links)


def _link(
    stops: Sequence[DriveStop],
    runs: Sequence[SnapshotRun],
    config: CalibrationConfig,
    workers: Workers,
    read_motions: Callable[[], Sequence[ViewPair]],
    deadline_s: float,
) -> tuple[FoundLinks, CalibrationResult]:
    """Link the stops, with more links as long as LiDARs are not placed, and return the links with the result."""
    against, lead = partial(contradiction_at, stops, config), partial(lead_at, stops)

    def joined(found: FoundLinks) -> CalibrationResult:
        return join(runs, config, found.links, against, lead, motions=found.motions, levels=found.levels)

    with threadpool_limits(1):
        found = search_links(stops, config, workers, deadline_s)
        result = joined(found)
        if found.links and time.monotonic() < deadline_s and any(not each.placed for each in result.placements):
            found = mark_unique(stops, config, workers, found)
            result = joined(found)
        if found.links and any(each.T_target_source is None for each in result.placements):
            known = found
            found = _followed_from_all(stops, config, workers, found, result, deadline_s)
            if found is not known:
                result = joined(found)
        if confirmed := _confirmed(stops, found, result):
            found = replace(found, links=(*found.links, *confirmed))
            result = joined(found)
        uncertain = {each.lidar for each in result.placements if each.status == "uncertain"}
        if uncertain:
            before = len(found.links)
            found = follow_poses(stops, config, workers, found, _view_poses(result), uncertain, deadline_s)
            found = replace(found, links=(*found.links, *_confirmed(stops, found, result)))
            if len(found.links) > before:
                result = joined(found)
        if any(_is_open(each) for each in result.placements):
            found = follow_motions(stops, config, workers, found, read_motions, deadline_s)
            if found.motions:
                result = joined(found)
    return found, result


def ways_of(snapshots: Mapping[str, Snapshot]) -> dict[str, ReadMotions]:
    """Return what reads the motions since the stop before, by the name of each snapshot with frames on the way."""
    return {name: each.read_motions for name, each in snapshots.items() if each.read_motions is not None}


def _followed_from_all(
    stops: Sequence[DriveStop],
    config: CalibrationConfig,
    workers: Workers,
    found: FoundLinks,
    result: CalibrationResult,
    deadline_s: float,
) -> FoundLinks:
    """Register views of LiDARs without a pose where all links together put them, with links that no other confirms.

    A wrong link puts views where their beams contradict each other, so the further links confirm the right ones. The
    headings of few links may have several solutions, half a turn apart: views are then registered where the one puts
    them that beams agree with.
    """
    pairs, grounds = [*_within(stops), *(link for link in found.links if link.counts)], ground_pairs(found.levels)
    unplaced = {each.lidar for each in result.placements if each.T_target_source is None}
    solutions = [solve_views(result.target, pairs, grounds)]
    if missing := unplaced - solutions[0].poses.poses.keys():
        limit_m = config.acceptance.max_baseline_m
        further = (
            each
            for each in solutions_on_plane(result.target, pairs, grounds, limit_m)
            if missing & each.poses.poses.keys() and all(is_near(pose, limit_m) for pose in each.poses.poses.values())
        )
        solutions = [*islice(further, _MOST_SOLUTIONS)] or solutions
    followed = [
        follow_poses(stops, config, workers, found, poses, unplaced, deadline_s)
        for each in solutions
        if (poses := each.view_poses)
    ]
    if not followed:
        return found
    if len(followed) > 1 and any(each.not_reached != found.not_reached for each in followed):
        return replace(found, not_reached=tuple(sorted({stops for each in followed for stops in each.not_reached})))
    best, *others = sorted(followed, key=_evidence_of, reverse=True)
    lead = min((_evidence_of(best) - _evidence_of(each) for each in others), default=inf)
    return best if lead >= config.acceptance.min_log_odds_margin else found


def _evidence_of(found: FoundLinks) -> float:
    """Return the evidence of all links, weak ones too."""
    return sum(link.registration.evidence for link in (*found.links, *found.weak))


def _within(stops: Sequence[DriveStop]) -> list[ViewPair]:
    pairs = ((stop.name, pair) for stop in stops for pair in stop.pairs)
    return [ViewPair(pair, name, name) for name, pair in pairs if pair.information is not None]


def _confirmed(stops: Sequence[DriveStop], found: FoundLinks, result: CalibrationResult) -> list[ViewPair]:
    """Return the weak links that count, if LiDARs are not placed without them, less certain than they say."""
    if not found.weak or all(each.placed for each in result.placements):
        return []
    grounds = ground_pairs(found.levels)
    confirmed = confirmed_links(result.target, _within(stops), found.links, found.weak, grounds)
    return [replace(link, registration=loosened(link.registration, _WEAKER)) for link in confirmed]


def _view_poses(result: CalibrationResult) -> dict[DriveView, RigidTransform]:
    """Return the pose of each LiDAR at each linked stop, relative to the target at the first of these stops."""
    return {
        (view := DriveView(lidar, stop.name)): RigidTransform(
            stop.first, view.label, stop.T_first_stop.matrix @ pose.matrix
        )
        for stop in result.stops
        for lidar, pose in result.poses.items()
    }


def _is_open(placement: LidarPlacement) -> bool:
    """Return whether motions or the ground may tell more of a pose than links do."""
    if placement.covariance is None:
        return placement.T_target_source is None
    return weakest_deviations(placement.covariance)[0] > OPEN_M


def calibrate_alone(
    name: str,
    snapshot: Snapshot,
    config: CalibrationConfig,
    observe: Observer,
    workers: Workers,
    deadline_s: float,
    prepared: dict[str, PreparedLidar] | None,
    earlier: EarlierStops,
) -> SnapshotRun:
    """Calibrate one stop, from the poses that earlier ones found; a refused one is only a run."""
    own = without_blind_target(snapshot, config)
    try:
        result = calibrate(snapshot, own, observe, None, workers, None, deadline_s, prepared, earlier)
    except UnfitSnapshotError as refusal:
        return SnapshotRun(
            name, None, snapshot.source, snapshot.source_sha256, refusal=str(refusal), lidars=snapshot.names
        )
    return SnapshotRun(name, result, snapshot.source, snapshot.source_sha256)
