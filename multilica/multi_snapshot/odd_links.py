# SPDX-License-Identifier: Apache-2.0
"""Links that are far from where the others put them: the place looks like another one."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from multilica.acceptance.view_graph import ViewGraph
from multilica.geometry import RigidTransform, rotation_angle_rad
from multilica.multi_snapshot.view_solution import solve_views
from multilica.registration.poses import is_distinct
from multilica.results import ViewPair

# So many links stand against each odd one.
_LEAST_AGAINST = 6
# Things that repeat along the way repeat alike at stops of one heading.
_TURN_RAD = float(np.deg2rad(45.0))


def odd_links(root: str, within: Sequence[ViewPair], links: Sequence[ViewPair]) -> list[ViewPair] | None:
    """Find the few links that are far from where many others put them.

    A link of another place contradicts all others. Links of one other place may agree with each other where the vehicle
    drives straight on, as the same motion leads to it from each stop; after a turn they contradict each other as well.
    So many links at stops of different headings, which agree but for one, are right.

    Args:
        within: pairs within stops.

    Returns:
        None if links contradict each other and nothing tells which are wrong.
    """
    odd: list[ViewPair] = []
    left = [*links]
    while _far_from_others(within, left):
        counts = [(len(_far_from_others(within, _without(left, each))), each) for each in left]
        fewest = min(count for count, _ in counts)
        best = [each for count, each in counts if count == fewest]
        if len(best) > 1 or len(left) - 1 < _LEAST_AGAINST * (len(odd) + 1):
            return None
        odd.append(best[0])
        left = _without(left, best[0])
    return odd if not odd or _turns(root, within, left) else None


def _without(links: Sequence[ViewPair], one: ViewPair) -> list[ViewPair]:
    return [each for each in links if each is not one]


def _far_from_others(within: Sequence[ViewPair], links: Sequence[ViewPair]) -> list[ViewPair]:
    views = sorted({view for pair in (*within, *links) for view in pair.views})
    found: list[ViewPair] = []
    for link in links:
        implied = ViewGraph.of(views, [*within, *_without(links, link)]).implied(link.target, link.source)
        known = link.registration.T_target_source
        if implied is not None and is_distinct(RigidTransform(known.target, known.source, implied.matrix), [known]):
            found.append(link)
    return found


def _turns(root: str, within: Sequence[ViewPair], links: Sequence[ViewPair]) -> bool:
    """Return whether each LiDAR is linked at stops between which the vehicle turns."""
    solution = solve_views(root, [*within, *links])
    stops = solution.poses.stops
    for lidar in {name for link in links for name in link.registration.lidars}:
        own = sorted({view.stop for link in links for view in link.views if view.lidar == lidar})
        turns = (
            rotation_angle_rad((stops[one].inverse() @ stops[other]).rotation)
            for one, other in combinations(own, 2)
            if {one, other} <= stops.keys()
        )
        if max(turns, default=0.0) < _TURN_RAD:
            return False
    return True
