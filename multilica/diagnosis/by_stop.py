# SPDX-License-Identifier: Apache-2.0
"""Explanation of a LiDAR that a drive of several stops does not place."""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import combinations
from math import acos, degrees, fsum

from multilica.diagnosis.explanation import Missing
from multilica.results.document import ResultDocument, StopEntry
from multilica.results.stops import StopLink

_ENOUGH_TURN_DEG = 60.0
_OTHER_CAUSES = ("dead_sensor", "no_returns_in_range", "disputed")


def explained_by_stop(document: ResultDocument, missing: Missing) -> Missing:
    """Add which stops see the LiDAR linked with others, and what helps; unchanged where no drive was calibrated."""
    sources = {each.sha256 for each in document.snapshots}
    of_one_log = document.config.drive.stops != 1 and len(sources) == 1 and "" not in sources
    if not (document.links or of_one_log) or missing.cause in _OTHER_CAUSES:
        return missing
    if missing.cause == "out_of_time":
        return replace(missing, by_stop="Not all links with other stops were sought.")
    own = [link for link in document.links if missing.lidar in (link.target, link.source)]
    turn_deg = _largest_turn_deg(document.stops)
    told = " ".join(_known(document, missing.lidar, own, turn_deg))
    return replace(missing, by_stop=told, advice=(*_advice(document, missing.lidar, own, turn_deg), *missing.advice))


def _known(document: ResultDocument, lidar: str, own: list[StopLink], turn_deg: float | None) -> Iterator[str]:
    stops = [snapshot.name for snapshot in document.snapshots if not snapshot.refusal]
    seen = _stops_of(lidar, own)
    if own:
        yield f"{len(seen)} of {len(stops)} stops see it linked with another stop: {', '.join(seen)}."
        yield f"Links that count: {sum(link.used for link in own)} of {len(own)}."
        reasons = Counter(link.reason for link in own if not link.used).most_common()
        if reasons:
            yield f"The others do not: {'; '.join(f'{reason} ({count})' for reason, count in reasons)}."
    else:
        yield f"none of {len(stops)} stops sees it linked with another stop."
    if own and not _with_others(own):
        yield "All its links are with itself: they tell how it moves, not where it is on the vehicle."
    ways = sum(motion.used for motion in document.motions if motion.lidar == lidar)
    if ways:
        yield f"Odometry followed it over {ways} {'way' if ways == 1 else 'ways'} between stops."
    if turn_deg is not None:
        yield f"The linked stops turn by at most {turn_deg:.0f} degrees."


def _advice(document: ResultDocument, lidar: str, own: list[StopLink], turn_deg: float | None) -> Iterator[str]:
    if turn_deg is None or turn_deg < _ENOUGH_TURN_DEG:
        yield f"turn by {_ENOUGH_TURN_DEG:g} degrees or more between two stops"
    others = _with_others(own)
    if others:
        places = " or ".join(_stops_of(lidar, others))
        yield f"add a stop near {places} where {lidar} sees the same again: a link counts only if others confirm it"
    else:
        limit_m = document.config.drive.max_distance_m
        yield f"add a stop where {lidar} sees what another LiDAR saw at another stop, at most {limit_m:g} m away"


def _with_others(own: Iterable[StopLink]) -> list[StopLink]:
    return [link for link in own if link.target != link.source]


def _stops_of(lidar: str, links: Iterable[StopLink]) -> list[str]:
    """Return the stops at which that LiDAR is one side of a link."""
    views = {view for link in links for view in ((link.target, link.target_stop), (link.source, link.source_stop))}
    return sorted(stop for name, stop in views if name == lidar)


def _largest_turn_deg(stops: Iterable[StopEntry]) -> float | None:
    """Return the largest angle between two linked stops; None without any."""
    return max(
        (_angle_deg(one, other) for one, other in combinations(stops, 2) if one.first == other.first), default=None
    )


def _angle_deg(one: StopEntry, other: StopEntry) -> float:
    rows = zip(one.T_first_stop[:3], other.T_first_stop[:3], strict=True)
    trace = fsum(a * b for first, second in rows for a, b in zip(first[:3], second[:3], strict=True))
    return degrees(acos(max(-1.0, min(1.0, (trace - 1.0) / 2.0))))
