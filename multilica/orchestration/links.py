# SPDX-License-Identifier: Apache-2.0
"""Links between the stops of a drive: searched, and followed from motions and poses."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

from multilica.config import CalibrationConfig
from multilica.geometry import RigidTransform
from multilica.orchestration.link_search import LinkSearch
from multilica.orchestration.pairs import lead_over_shifts
from multilica.orchestration.stop_views import DriveStop
from multilica.results import DriveView, ViewPair
from multilica.workers import Workers

MAX_LINKED_STOPS = 8
"""Prepared clouds of more stops take much memory, and all their pairs much time."""


@dataclass(frozen=True, slots=True)
class FoundLinks:
    """Registrations between stops.

    Args:
        links: accepted or uncertain, or undecided where another place along the way fits better.
        weak: others, which have too little evidence to count without links that confirm them.
        not_reached: pairs of stops whose views there was no time to search.
        motions: of LiDARs between the stops, if they were read.
        levels: poses of LiDARs over the ground.
    """

    links: tuple[ViewPair, ...] = ()
    weak: tuple[ViewPair, ...] = ()
    not_reached: tuple[tuple[str, str], ...] = ()
    motions: Sequence[ViewPair] = ()
    levels: Mapping[str, RigidTransform] = field(default_factory=dict)


def search_links(
    stops: Sequence[DriveStop], config: CalibrationConfig, workers: Workers, deadline_s: float = float("inf")
) -> FoundLinks:
    """Register views of different stops, the most promising first, until they are linked or nothing promising is left.

    A pair whose pose follows from others is not searched: the beams test that pose, and it is registered from there.
    So most links have others that confirm them.

    Returns:
        The registrations, none of which is confirmed, those with less evidence, and what there was no time for.
    """
    if not _may_link(stops, config):
        return FoundLinks()
    search = LinkSearch(stops[:MAX_LINKED_STOPS], config, workers, deadline_s)
    try:
        search.run()
    finally:
        workers.forget()
    weak = tuple(link for pair, link in search.weak.items() if pair not in search.links)
    return FoundLinks(tuple(search.links.values()), weak, tuple(sorted(search.not_reached)), levels=search.levels)


def mark_unique(
    stops: Sequence[DriveStop], config: CalibrationConfig, workers: Workers, found: FoundLinks
) -> FoundLinks:
    """Mark the links that fit at no place beside their own, so that others need to tell only their attitude."""
    search = LinkSearch(stops[:MAX_LINKED_STOPS], config, workers, float("inf"), found.levels)
    counting = [link for link in found.links if link.counts]
    try:
        search.share()
        leads = [*workers.map(lead_over_shifts, [link.registration.registrations[0] for link in counting])]
    finally:
        workers.forget()
    margin = config.acceptance.min_log_odds_margin
    marked = {id(link): replace(link, is_unique=lead >= margin) for link, lead in zip(counting, leads, strict=True)}
    return replace(found, links=tuple(marked.get(id(link), link) for link in found.links))


def follow_motions(
    stops: Sequence[DriveStop],
    config: CalibrationConfig,
    workers: Workers,
    found: FoundLinks,
    read_motions: Callable[[], Sequence[ViewPair]],
    deadline_s: float = float("inf"),
) -> FoundLinks:
    """Register views of different stops from the poses that motions of their LiDARs tell, where links leave some open.

    Args:
        found: by `search_links`; these links are kept.
        read_motions: returns the motions of LiDARs between the stops by odometry.

    Returns:
        The links, with the motions.
    """
    motions = read_motions() if _may_link(stops, config) else ()
    if not motions:
        return found
    search = LinkSearch(stops[:MAX_LINKED_STOPS], config, workers, deadline_s, found.levels, found.links)
    try:
        search.follow(motions)
    finally:
        workers.forget()
    return replace(_with_found(found, search), motions=motions)


def follow_poses(
    stops: Sequence[DriveStop],
    config: CalibrationConfig,
    workers: Workers,
    found: FoundLinks,
    poses: Mapping[DriveView, RigidTransform],
    lidars: Collection[str],
    deadline_s: float = float("inf"),
) -> FoundLinks:
    """Register views of different stops from the poses that all links tell together, where these are not precise.

    All links together may tell poses that no chain of them tells, and each further link makes them more precise.

    Args:
        found: links that tell the poses.
        poses: of views. Those with the same target have linked stops.
        lidars: only their views are registered, with those of any LiDAR.

    Returns:
        All links, those with little evidence among the weak ones.
    """
    search = LinkSearch(stops[:MAX_LINKED_STOPS], config, workers, deadline_s, found.levels, found.links)
    try:
        search.follow_poses(poses, lidars)
    finally:
        workers.forget()
    return _with_found(found, search)


def _with_found(found: FoundLinks, search: LinkSearch) -> FoundLinks:
    """Add what a further search found; a weak link goes where the same views were registered again."""
    links = (*found.links, *search.links.values())
    new = [link for pair, link in search.weak.items() if pair not in search.links]
    known = {link.views for link in (*links, *new)}
    weak = (*(link for link in found.weak if link.views not in known), *new)
    not_reached = tuple(sorted({*found.not_reached, *search.not_reached}))
    return replace(found, links=links, weak=weak, not_reached=not_reached)


def _may_link(stops: Sequence[DriveStop], config: CalibrationConfig) -> bool:
    return config.drive.max_distance_m > 0.0 and config.verify.enabled and len(stops) > 1
