# SPDX-License-Identifier: Apache-2.0
"""Links between stops that have too little evidence of their own, and that the others confirm."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from multilica.multi_snapshot.pair_equations import LARGEST_RESIDUAL
from multilica.multi_snapshot.view_solution import ViewSolution, solve_views
from multilica.results import ViewPair

# Narrow views of few stops need two more links at most. Each of the likeliest is tried with each, which takes seconds.
_MOST, _AT_ONCE = 3, 2


def confirmed_links(
    root: str,
    within: Sequence[ViewPair],
    links: Sequence[ViewPair],
    weak: Sequence[ViewPair],
    grounds: Sequence[ViewPair] = (),
) -> list[ViewPair]:
    """Return the weak links that fit all links and pairs, and that others confirm.

    A wrong link is anywhere. One that ends where the others put it has more evidence by that than by its surfaces.

    Args:
        within: pairs within stops.
        links: between stops, with enough evidence.
        weak: other links between stops, none of which counts without the others.
        grounds: pairs of LiDARs that see the same ground.

    Returns:
        None if links leave the pose of a LiDAR open, and no few of them tell one.
    """
    sure = [pair for pair in within if pair.registration.information is not None]
    sure += [link for link in links if link.counts]
    ranked = sorted(weak, key=lambda link: (-link.registration.evidence, link.target, link.source))
    confirmed = _first(root, sure, ranked, grounds)
    if confirmed is None:
        return []
    for link in ranked:
        if link not in confirmed and all_fit(solve_views(root, [*sure, *confirmed, link], grounds), [*confirmed, link]):
            confirmed.append(link)
    return confirmed


def _first(
    root: str, sure: Sequence[ViewPair], ranked: Sequence[ViewPair], grounds: Sequence[ViewPair]
) -> list[ViewPair] | None:
    """Return the fewest weak links that tell the pose of another LiDAR; none are needed if all are told."""
    known = solve_views(root, sure, grounds).poses.poses.keys()
    if {view.lidar for pair in (*sure, *ranked) for view in pair.views} <= known:
        return []
    for count in range(1, _AT_ONCE + 1):
        for added in combinations(ranked[:_MOST], count):
            if _may_tell([*sure, *added]):
                solution = solve_views(root, [*sure, *added], grounds)
                if len(solution.poses.poses) > len(known) and all_fit(solution, added):
                    return list(added)
    return None


def _may_tell(pairs: Sequence[ViewPair]) -> bool:
    """Return whether there are more pairs than poses of LiDARs and stops, so that some can confirm others."""
    lidars = {view.lidar for pair in pairs for view in pair.views}
    stops = {stop for pair in pairs if pair.is_link for stop in pair.stops}
    return len(pairs) > len(lidars) - 1 + len(stops) - 1


def all_fit(solution: ViewSolution, added: Sequence[ViewPair]) -> bool:
    """Return whether others tell where each added link has to be, and every link and pair is where it has to be."""
    if not all(solution.is_confirmed(link) for link in added):
        return False
    return all(_residual(solution, pair) < LARGEST_RESIDUAL for pair in solution.pairs)


def _residual(solution: ViewSolution, pair: ViewPair) -> float:
    offset = solution.poses.offset(pair)
    return float(offset @ np.asarray(pair.registration.information) @ offset)
