# SPDX-License-Identifier: Apache-2.0
"""Choice of the links between stops that poses may rest on."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from types import MappingProxyType

from multilica.acceptance.consistency import most_contradicting
from multilica.config import RefineConfig
from multilica.geometry import LEVER_ARM_M, FloatArray, RigidTransform
from multilica.multi_snapshot.common_ground import ground_pairs
from multilica.multi_snapshot.knocks import PossibleKnock, find_knock, find_possible_knock, spares
from multilica.multi_snapshot.motions import (
    ToldPose,
    agreeing_motions,
    described,
    links_off_course,
    poses_by_motions,
)
from multilica.multi_snapshot.odd_links import odd_links
from multilica.multi_snapshot.pose_conflicts import SnapshotPairs
from multilica.multi_snapshot.view_solution import ViewSolution, solve_views
from multilica.registration.poses import is_near
from multilica.registration.widening import loosened
from multilica.results import DriveView, Knock, LinkedStops, StopLink, StopMotion, ViewPair, connected
from multilica.results.registrations import weakest_deviations
from multilica.stages.refine import RefinedRig, refine

ContradictionAt = Callable[[RigidTransform, Collection[str]], str]
"""Returns the stop, other than those, at which beams contradict a pose of two LiDARs; "" if none do."""

# Beams contradict a pose that is off by more.
_TOLD_M = 0.3
# Factor of the standard deviations of links whose position no other tells.
_ALONE_IN_PLACE = 2.0
_ALONE = "no other link confirms it"
_ELSEWHERE = "other stops put one of its LiDARs elsewhere on the vehicle"
_ODD = "all other links put it elsewhere"
_APART = "links contradict each other, so the place looks like another one"
_ALIKE = "stops contradict each other, so the place looks like another one"
_CONTRADICTED = "it contradicts other links and pairs"
_OFF_COURSE = "the motion of the LiDARs between the stops contradicts it, so the place looks like another one"


@dataclass(frozen=True, slots=True)
class RigConflict:
    """Two LiDARs whose pose beams contradict at a stop, or that would not be on one vehicle: then without a stop."""

    target: str
    source: str
    stop: str

    @property
    def text(self) -> str:
        """The conflict for people."""
        if not self.stop:
            return f"it puts {self.source} farther from {self.target} than acceptance.max_baseline_m allows"
        return f"it puts {self.source} where its beams and those of {self.target} contradict each other at {self.stop}"


@dataclass(frozen=True, slots=True, eq=False)
class LinkedRig:
    """A rig after the joint refinement over all stops.

    Args:
        links: that its poses rest on, as `rig.links` has their residuals.
        refused: per link that is not used, why.
        within: pairs within stops that its poses rest on.
        conflicts: poses of LiDARs that cannot be.
        knocks: LiDARs that moved between stops; the stops on one side of that do not count for them.
        by_motions: poses of LiDARs that only their motions between the stops tell, or but for the ground.
        motions: all that were measured.
        possible_knock: a motion of a LiDAR between stops that is not certain enough to count as one of `knocks`.
    """

    rig: RefinedRig
    linked: LinkedStops
    refused: Mapping[ViewPair, str]
    within: Sequence[ViewPair]
    conflicts: tuple[RigConflict, ...]
    knocks: tuple[Knock, ...]
    by_motions: Mapping[str, ToldPose] = field(default_factory=dict)
    motions: tuple[StopMotion, ...] = ()
    possible_knock: PossibleKnock | None = None

    @property
    def links(self) -> tuple[StopLink, ...]:
        """All links, used ones with their residuals."""
        used = (
            replace(
                _described(link),
                used=True,
                after_m=residual.after_m,
                after_deg=residual.after_deg,
                probability=residual.probability,
            )
            for link, residual in zip(self.linked.links, self.rig.links, strict=True)
        )
        return (*used, *(replace(_described(link), reason=reason) for link, reason in self.refused.items()))


def refine_linked(
    root: str,
    pairs: SnapshotPairs,
    links: Sequence[ViewPair],
    config: RefineConfig,
    contradiction_at: ContradictionAt | None = None,
    inconsistent: Collection[DriveView] = (),
    *,
    looks_alike: bool = False,
    motions: Sequence[ViewPair] = (),
    levels: Mapping[str, RigidTransform] = MappingProxyType({}),
    max_baseline_m: float = math.inf,
) -> LinkedRig:
    """Refine a rig over all stops, with the links that others confirm and none contradicts.

    Two places may look alike, and between stops no limit of distance helps. So a link counts only where the other links
    and the pairs within the stops imply its pose as well: by another link between the same stops, or by a cycle over
    stops. A link that is far from the others shows that the place looks like another, and none counts, unless many
    others agree after a turn. One that differs by more than the covariances allow goes, the least probable first.

    A hall whose ends look alike may join views consistently and yet wrongly. The pose of two LiDARs that follows then
    contradicts their beams at other stops, and no link of that drive counts. Nor does one if links put two LiDARs
    farther apart than any two of one vehicle are. If a pair within a stop tells a pose that beams contradict, it goes
    instead, and links are compared without it.

    Args:
        inconsistent: views of LiDARs that are elsewhere on the vehicle than at other stops.
        looks_alike: the place is known to look like another.
        motions: of LiDARs between stops by odometry. They refuse links, confirm others, and place LiDARs that nothing
            else places; poses that rest on links and pairs do not depend on them.
        levels: poses of LiDARs over the ground.
        max_baseline_m: as `acceptance.max_baseline_m`.
    """
    within = [ViewPair(pair, name, name) for name, own in pairs.items() for pair in own if pair.information is not None]
    contradicted: list[RigConflict] = []
    knocks: list[Knock] = []
    moved = {*inconsistent}
    refused = _refused(links, moved)
    links = [link for link in links if link not in refused]
    left = [link for link in links if link.counts]
    grounds = ground_pairs(levels)
    agreeing, course = agreeing_motions(root, within, motions)
    left = _refuse(dict.fromkeys(links_off_course(course, left), _OFF_COURSE), refused, left)
    left = _refuse(dict.fromkeys(left, _ALIKE) if looks_alike else _far(root, within, left, grounds), refused, left)
    while True:
        solution = solve_views(root, [*within, *left], grounds)
        followed = solve_views(root, [*within, *left, *agreeing], grounds) if agreeing and left else solution
        alone = [link for link in solution.linked.links if not followed.is_confirmed(link)]
        if alone:
            refused.update(dict.fromkeys(alone, _ALONE))
            left = [link for link in left if link not in alone]
            continue
        knock = find_knock(root, solution, [*pairs]) if left else None
        if knock is not None:
            knocks.append(knock)
            moved |= {DriveView(knock.lidar, stop) for stop in knock.left_out}
            refused.update((link, knock.text) for link in left if not spares(knock, link))
            within, left = ([pair for pair in each if spares(knock, pair)] for each in (within, left))
            continue
        linked = solution.linked
        rig = refine(
            root,
            _told_poses(root, solution, within),
            [pair.registration for pair in within],
            config,
            replace(linked, links=[_as_certain_as_told(link, followed) for link in linked.links]),
            [pair.target_stop for pair in within],
        )
        doubtful = [residual for residual in rig.links if residual.contradicts]
        if not doubtful:
            against = _conflict(rig, within, contradiction_at, moved, max_baseline_m if left else math.inf)
            if against is None:
                break
            contradicted.append(against)
            if left and not (against.stop and _is_of_stops(against, within)):
                refused.update(dict.fromkeys(left, against.text))
                left = []
                continue
            within = _without(within, against)
            left = [*left, *_restored(refused)]
            left = _refuse(_far(root, within, left, grounds), refused, left)
            continue
        worst = linked.links[rig.links.index(most_contradicting(doubtful))]
        refused[worst] = _CONTRADICTED
        left = [link for link in left if link is not worst]
    apart = [link for link in left if link not in linked.links]
    refused.update(dict.fromkeys(apart, f"nothing connects it to {root}"))
    return LinkedRig(
        rig,
        linked,
        refused,
        within,
        tuple(contradicted),
        tuple(knocks),
        poses_by_motions(root, [*within, *left], agreeing, rig.covariances, grounds),
        tuple(described(each, used=each in agreeing) for each in motions),
        find_possible_knock(root, solution, [*pairs]) if left else None,
    )


def _as_certain_as_told(link: ViewPair, solution: ViewSolution) -> ViewPair:
    """Return a link, less certain than it says if nothing but itself tells where it is."""
    if not link.is_unique or solution.tells_place_of(link):
        return link
    return replace(link, registration=loosened(link.registration, _ALONE_IN_PLACE))


def _told_poses(root: str, solution: ViewSolution, within: Sequence[ViewPair]) -> dict[str, RigidTransform]:
    """Return the poses that pairs or links tell: without links, the ground alone tells no position."""
    poses = solution.poses.poses
    told = poses.keys() if solution.linked.links else connected(root, [pair.registration for pair in within])
    return {name: pose for name, pose in poses.items() if name in told}


def _refused(links: Sequence[ViewPair], moved: set[DriveView]) -> dict[ViewPair, str]:
    """Return why links do not count before any is compared with others."""
    undecided = [link for link in links if link.registration.verdict.outcome == "undecided"]
    elsewhere = [link for link in links if link.views & moved]
    return {**{link: link.registration.verdict.text for link in undecided}, **dict.fromkeys(elsewhere, _ELSEWHERE)}


def _refuse(found: Mapping[ViewPair, str], refused: dict[ViewPair, str], links: Sequence[ViewPair]) -> list[ViewPair]:
    """Add what was found to the refused links, and return the others."""
    refused.update(found)
    return [link for link in links if link not in refused]


def _far(
    root: str, within: Sequence[ViewPair], links: Sequence[ViewPair], grounds: Sequence[ViewPair]
) -> dict[ViewPair, str]:
    """Return the links that are far from the others, or all if nothing tells which are wrong, with the reason."""
    odd = odd_links(root, within, links, grounds)
    return dict.fromkeys(links, _APART) if odd is None else dict.fromkeys(odd, _ODD)


def _restored(refused: dict[ViewPair, str]) -> list[ViewPair]:
    """Take the links that a wrong pair may have refused out of the refused ones, and return them."""
    found = [link for link, reason in refused.items() if reason in (_ALONE, _CONTRADICTED, _ODD, _APART)]
    for link in found:
        del refused[link]
    return found


def _conflict(
    rig: RefinedRig,
    within: Sequence[ViewPair],
    contradiction_at: ContradictionAt | None,
    moved: Collection[DriveView],
    max_baseline_m: float,
) -> RigConflict | None:
    """Find two LiDARs that are too far apart, or whose pose beams contradict.

    The beams count at stops where the pose was not registered, and none of the two moved. Poses that are not determined
    prove nothing.
    """
    told = [name for name in sorted(rig.poses) if name not in rig.covariances or _is_told(rig.covariances[name])]
    for target, source in combinations(told, 2):
        pose = rig.poses[target].inverse() @ rig.poses[source]
        if not is_near(pose, max_baseline_m):
            return RigConflict(target, source, "")
        own = {pair.target_stop for pair in within if pair.registration.lidars == {target, source}}
        own |= {view.stop for view in moved if view.lidar in (target, source)}
        stop = "" if contradiction_at is None else contradiction_at(pose, own)
        if stop:
            return RigConflict(target, source, stop)
    return None


def _is_of_stops(conflict: RigConflict, within: Sequence[ViewPair]) -> bool:
    """Return whether pairs within stops alone put the two LiDARs where they cannot be."""
    return conflict.source in connected(conflict.target, [pair.registration for pair in within])


def _is_told(covariance: FloatArray) -> bool:
    sigma_m, sigma_rad = weakest_deviations(covariance)
    return max(sigma_m, LEVER_ARM_M * sigma_rad) < _TOLD_M


def _without(within: Sequence[ViewPair], conflict: RigConflict) -> list[ViewPair]:
    """Leave out the pairs that put two LiDARs where they cannot be: their own, else all that connect them."""
    ends = {conflict.target, conflict.source}
    kept = [pair for pair in within if pair.registration.lidars != ends]
    if len(kept) < len(within):
        return kept
    group = connected(conflict.target, [pair.registration for pair in within])
    return [pair for pair in within if pair.registration.target not in group]


def _described(link: ViewPair) -> StopLink:
    return StopLink(*link.target, *link.source, link.registration.evidence, used=False)
