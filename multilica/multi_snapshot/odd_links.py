# SPDX-License-Identifier: Apache-2.0
"""Links that are far from where the others put them: the place looks like another one."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from multilica.acceptance.view_graph import ViewGraph
from multilica.geometry import RigidTransform, rotation_angle_rad
from multilica.multi_snapshot.view_solution import ViewSolution, solve_views
from multilica.multi_snapshot.weak_links import all_fit
from multilica.registration.poses import is_distinct
from multilica.results import ViewPair

# So many links stand against each odd one.
_LEAST_AGAINST = 6
# Things that repeat along the way repeat alike at stops of one heading.
_TURN_RAD = float(np.deg2rad(45.0))


def odd_links(
    root: str, within: Sequence[ViewPair], links: Sequence[ViewPair], grounds: Sequence[ViewPair] = ()
) -> list[ViewPair] | None:
    """Find the few links that are far from where many others put them.

    A link of another place contradicts all others. Links of one other place may agree with each other where the vehicle
    drives straight on, as the same motion leads to it from each stop; after a turn they contradict each other as well.
    So links at stops of different headings are right if they confirm each other.

    Args:
        within: pairs within stops.
        grounds: pairs of LiDARs that see the same ground.

    Returns:
        None if links contradict each other and nothing tells which are wrong.
    """
    odd: list[ViewPair] = []
    left = [*links]
    while _far_from_others(within, left):
        counts = [(len(_far_from_others(within, _without(left, each))), each) for each in left]
        fewest = min(count for count, _ in counts)
        best = [each for count, each in counts if count == fewest]
        if len(best) > 1:
            return None
        odd.append(best[0])
        left = _without(left, best[0])
    if not odd:
        return odd
    solution = _confirmed(root, within, left, grounds)
    sure = solution.linked.links
    against = len(sure) >= _LEAST_AGAINST * len(odd) and all(_is_far(solution, each) for each in odd)
    return odd if against and all_fit(solution, sure) and _turns(solution, sure) else None


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


def _confirmed(
    root: str, within: Sequence[ViewPair], links: Sequence[ViewPair], grounds: Sequence[ViewPair]
) -> ViewSolution:
    """Return the poses by the links that confirm each other."""
    while True:
        solution = solve_views(root, [*within, *links], grounds)
        confirmed = [link for link in solution.linked.links if solution.is_confirmed(link)]
        if len(confirmed) == len(links):
            return solution
        links = confirmed


def _is_far(solution: ViewSolution, link: ViewPair) -> bool:
    """Return whether a solution with one group of linked stops puts a link elsewhere."""
    poses, known = solution.poses, link.registration.T_target_source
    told = link.registration.lidars <= poses.poses.keys() and link.stops <= poses.stops.keys()
    if not told or len(solution.first) != 1:
        return False
    target, source = (poses.pose_of(view, within=False) for view in (link.target, link.source))
    there = RigidTransform(known.target, known.source, (target.inverse() @ source).matrix)
    return is_distinct(there, [known])


def _turns(solution: ViewSolution, links: Sequence[ViewPair]) -> bool:
    """Return whether each LiDAR is linked at stops between which the vehicle turns."""
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
