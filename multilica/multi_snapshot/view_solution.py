# SPDX-License-Identifier: Apache-2.0
"""Poses of LiDARs and stops by all pairs of views together, also where no chain of pairs tells them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from multilica.acceptance.view_graph import ViewGraph
from multilica.geometry import LEVER_ARM_M, FloatArray, RigidTransform, rotation_vector
from multilica.multi_snapshot.common_ground import ground_pairs_of
from multilica.multi_snapshot.pair_equations import LARGEST_RESIDUAL, PairEquations
from multilica.multi_snapshot.planar_poses import PlanarPoses, planar_poses
from multilica.registration.poses import is_distinct
from multilica.registration.view_poses import UNKNOWN, ViewPoses
from multilica.results import DriveView, LinkedStops, PairRegistration, Verdict, ViewPair

_ITERATIONS = 40
_EPSILON = 1e-6
# From afar, links that are certain to a millimetre lead to the nearest of many wrong minima: at first they count less.
_ROUGHLY = tuple(np.diag(np.repeat([np.deg2rad(10.0 * each) ** 2, each**2], 3)) for each in (1.0, 0.1))
# The rough fit of the true poses is better than this, per pair.
_ROUGH_FITTING = 0.1
# A fit ends where the sum of the squared residuals falls by no larger share.
_LEAST_GAIN, _LEAST_ROUGH_GAIN = 1e-6, 1e-2
# Headings from which the pose of a LiDAR is sought that no chain of pairs tells.
_HEADINGS = 8
# Poses that no chain tells fit within this, per degree of freedom, and all others are worse by so much in all.
_FITTING, _LEAD = 9.0, 100.0
# Places that look alike are farther apart; rotations count as arcs at 10 m.
_CONFIRMED_M = 0.3
# Along one axis, if the others are known: posts, bays and niches that repeat are three times as far apart.
_ALONG_ONE_AXIS_M = 0.7
# A smaller turn of the vehicle does not tell the vertical.
_TURN_RAD = float(np.deg2rad(20.0))
_VERTICAL = 0.9
# Along a direction that turns by more, 3 deg per metre, no place looks alike: repeated ones have the same attitude.
_TURNS = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class ViewSolution:
    """The poses that fit all pairs best, without systematic errors of the LiDARs.

    Args:
        pairs: those that count, within stops and between them.
        first: the first of each group of linked stops.
        squared: sum of the squared residuals, with their robust loss.
        information: (N, N) of the unknowns.
        grounds: pairs of LiDARs that see the same ground; they count besides.
    """

    poses: ViewPoses
    pairs: Sequence[ViewPair]
    first: frozenset[str]
    squared: float
    information: FloatArray
    grounds: Sequence[ViewPair] = ()

    @property
    def linked(self) -> LinkedStops:
        """The links with the poses of the stops."""
        return LinkedStops([pair for pair in self.pairs if pair.is_link], self.poses.stops, self.first)

    @property
    def covariance(self) -> FloatArray:
        """(N, N) of the unknowns; what nothing determines is wide."""
        return np.asarray(np.linalg.inv(self.information + _prior(len(self.information))), dtype=np.float64)

    @property
    def fits(self) -> bool:
        """True if there are more equations than unknowns, and they fit."""
        freedom = 6 * len(self.pairs) + 3 * len(self.grounds) - self.poses.columns
        return freedom > 0 and self.squared < _FITTING * freedom

    def beyond(self, max_baseline_m: float) -> float:
        """Return the squared residual of the LiDAR that lies farthest beyond a distance from the root; 0 if none does.

        One that lies there only along a direction that hardly anything determines has a small one.
        """
        excess = [
            max(0.0, float(np.linalg.norm(self.poses.poses[name].xyz_m)) - max_baseline_m) for name in self.poses.free
        ]
        covariance = self.covariance
        blocks = (covariance[column : column + 3, column : column + 3] for column in range(3, 6 * len(excess), 6))
        return max(
            (each**2 / float(np.linalg.eigvalsh(block)[-1]) for each, block in zip(excess, blocks, strict=True)),
            default=0.0,
        )

    @property
    def view_poses(self) -> dict[DriveView, RigidTransform]:
        """The pose of each LiDAR at each linked stop, relative to the root at the first stop; none of stops apart."""
        if len(self.first) != 1:
            return {}
        (first,) = self.first
        return {
            (view := DriveView(lidar, stop)): RigidTransform(first, view.label, of_stop.matrix @ pose.matrix)
            for stop, of_stop in self.poses.stops.items()
            for lidar, pose in self.poses.poses.items()
        }

    def leaves_open(self, pose: RigidTransform) -> bool:
        """Return whether another pose of a LiDAR differs only along directions that nothing determines."""
        number = 6 * self.poses.free.index(pose.source)
        block = slice(number, number + 6)
        offset = pose.offset_from(self.poses.poses[pose.source])
        return bool(offset @ np.linalg.solve(self.covariance[block, block], offset) < LARGEST_RESIDUAL)

    def is_confirmed(self, link: ViewPair) -> bool:
        """Return whether the others tell where the link has to be, if only roughly along one axis.

        A height that no drive on a plane tells may stay open, and so may a turn, along which no place repeats. If the
        link fits at no other place, the others need to tell only its attitude: a hall that looks the same when turned
        would turn it.

        They do not if one of its LiDARs has no pose here.
        """
        if link not in self.pairs:
            return False
        if link.is_unique:
            attitude = self._told_by_others(link)[:3, :3]
            if np.linalg.eigvalsh(attitude)[-1] < _CONFIRMED_M**2:
                return True
        return self.tells_place_of(link)

    def tells_place_of(self, link: ViewPair) -> bool:
        """Return whether the others tell the position of a link of this solution too, as `is_confirmed` wants it."""
        variances, directions = np.linalg.eigh(self._told_by_others(link))
        loose = directions[:, variances > _CONFIRMED_M**2]
        if loose.shape[1] == 0 or (loose.shape[1] == 1 and variances[-1] < _ALONG_ONE_AXIS_M**2):
            return True
        if loose.shape[1] == 1 and np.linalg.norm(loose[:3, 0]) > _TURNS:
            return True
        up = self._vertical
        if loose.shape[1] > 1 or up is None:
            return False
        rotation = self.poses.pose_of(link.target, within=not link.is_link).rotation
        return bool(np.abs(loose[3:, 0] @ (rotation.T @ up)) > _VERTICAL)

    def _told_by_others(self, link: ViewPair) -> FloatArray:
        """Return the covariance (6, 6) of a link's pose by all other pairs; rotations count as arcs."""
        jacobian, columns = self.poses.jacobian(link)
        others = [pair for pair in self.pairs if pair is not link]
        information = PairEquations.of(self.poses, others, self.grounds).at(self.poses).information
        inverse = np.linalg.inv(information + _prior(len(information)))
        scale = np.repeat([LEVER_ARM_M, 1.0], 3)
        return np.asarray(jacobian @ inverse[np.ix_(columns, columns)] @ jacobian.T * np.outer(scale, scale))

    @property
    def _vertical(self) -> FloatArray | None:
        """The axis (3,) about which the vehicle turns most, in the frame of the root; None if it hardly turns."""
        turns = [rotation_vector(pose.rotation) for pose in self.poses.stops.values()]
        largest = max(turns, key=lambda turn: float(np.linalg.norm(turn)), default=np.zeros(3))
        angle_rad = float(np.linalg.norm(largest))
        return largest / angle_rad if angle_rad > _TURN_RAD else None


def solve_near(known: ViewSolution, pairs: Sequence[ViewPair], added: Mapping[str, RigidTransform]) -> ViewSolution:
    """Fit the poses to other pairs, from where they are.

    Args:
        added: poses of further LiDARs to begin with.
    """
    state = known.poses
    state = replace(state, poses={**state.poses, **added}, free=sorted([*state.free, *added]))
    return _fit(replace(known, poses=state, pairs=pairs))


def solve_views(root: str, pairs: Sequence[ViewPair], grounds: Sequence[ViewPair] = ()) -> ViewSolution:
    """Find the poses of LiDARs and stops that follow from the pairs, relative to the root.

    Chains of pairs tell most poses. Two groups of views that no pair connects may still determine each other, as in
    hand-eye calibration, if the vehicle turns: then poses follow from all solutions on a plane, if these share them.
    Without ground in sight, the pose of such a LiDAR is sought from several headings.

    Args:
        grounds: pairs of LiDARs that see the same ground.
    """
    views = sorted({view for pair in pairs for view in pair.views})
    assumed: list[ViewPair] = []
    solution = _fit(_started(root, views, pairs, assumed, grounds))
    while (found := _next_lidar(root, views, pairs, assumed, grounds, solution)) is not None:
        assumed.append(found)
        solution = _fit(_started(root, views, pairs, assumed, grounds))
    return solution


def solutions_on_plane(
    root: str, pairs: Sequence[ViewPair], grounds: Sequence[ViewPair], max_baseline_m: float
) -> list[ViewSolution]:
    """Find all poses that fit the pairs as well as errors allow, of the LiDARs whose headings follow; the best first.

    Args:
        max_baseline_m: no LiDAR of a vehicle is farther from the root. That one is, also counts as a residual.
    """
    found = [_fit(_fit(_on_plane(start, pairs, grounds), _ROUGHLY[1])) for start in planar_poses(root, pairs, grounds)]
    within = [replace(each, squared=each.squared + each.beyond(max_baseline_m)) for each in found]
    return sorted((each for each in within if each.fits), key=lambda each: each.squared)


def _on_plane(start: PlanarPoses, pairs: Sequence[ViewPair], grounds: Sequence[ViewPair]) -> ViewSolution:
    """Return poses on a plane with the pairs of their LiDARs and stops, not fitted yet."""
    lidars, stops = {*start.poses}, {*start.stops}
    used = [pair for pair in pairs if pair.registration.lidars <= lidars and (not pair.is_link or pair.stops <= stops)]
    first = frozenset([*start.stops][:1])
    free = sorted(name for name in lidars if start.poses[name].target != name)
    state = ViewPoses(start.poses, start.stops, free, sorted(stops - first))
    seen = ground_pairs_of(lidars, grounds)
    return ViewSolution(state, used, first, np.inf, np.zeros((state.columns, state.columns)), seen)


def _anchors(lidar: str, views: Sequence[DriveView], known: ViewSolution) -> list[DriveView]:
    """Return views of LiDARs with a pose, at stops with a view of another LiDAR."""
    return [
        DriveView(name, view.stop)
        for view in views
        if view.lidar == lidar
        for name in sorted(known.poses.poses)
        if DriveView(name, view.stop) in views
    ]


def _next_lidar(
    root: str,
    views: Sequence[DriveView],
    pairs: Sequence[ViewPair],
    assumed: Sequence[ViewPair],
    grounds: Sequence[ViewPair],
    known: ViewSolution,
) -> ViewPair | None:
    """Return the pose on the vehicle of one more LiDAR, as a pair with one that has a pose; None if there is none."""
    left = {view.lidar for view in views} - known.poses.poses.keys()
    if not left:
        return None
    on_plane = solutions_on_plane(root, pairs, grounds, float(UNKNOWN[-1]))
    if (shared := _shared(views, known, on_plane)) is not None:
        return shared
    for lidar in sorted(left - {name for each in on_plane for name in each.poses.poses}):
        anchors = _anchors(lidar, views, known)
        if not anchors:
            continue
        starts = [_assumed(root, lidar, anchors[0], known, heading) for heading in range(_HEADINGS)]
        near = _fits(lidar, [_started(root, views, pairs, [*assumed, start], grounds) for start in starts])
        complete = all(lidar in each.poses.poses for each in near)
        if complete and (shared := _shared(views, known, near)) is not None:
            return shared
    return None


def _shared(views: Sequence[DriveView], known: ViewSolution, found: Sequence[ViewSolution]) -> ViewPair | None:
    """Return one more pose that all solutions share, as a pair with a LiDAR that has a pose; None if there is none."""
    if not found:
        return None
    best, *others = sorted(found, key=lambda each: each.squared)
    if not best.fits:
        return None
    told = {name for pair in best.pairs for name in pair.registration.lidars}
    near = [each.poses.poses for each in others if each.squared <= best.squared + _LEAD]
    for lidar in sorted(told - known.poses.poses.keys()):
        pose, anchors = best.poses.poses[lidar], _anchors(lidar, views, known)
        if anchors and all(
            lidar in poses and (not is_distinct(poses[lidar], [pose]) or best.leaves_open(poses[lidar]))
            for poses in near
        ):
            return _pseudo(best.poses.poses[anchors[0].lidar].inverse() @ pose, anchors[0].stop)
    return None


def _is_afar(solution: ViewSolution, lidar: str) -> bool:
    """Return whether a LiDAR came to lie beyond any vehicle, along a direction that nothing determines."""
    pose = solution.poses.poses.get(lidar)
    return pose is not None and float(np.linalg.norm(pose.xyz_m)) > UNKNOWN[-1]


def _assumed(root: str, lidar: str, anchor: DriveView, known: ViewSolution, heading: int) -> ViewPair:
    yaw_rad = 2.0 * np.pi * heading / _HEADINGS
    of_root = RigidTransform.from_xyz_rpy(root, lidar, (0.0, 0.0, 0.0), (0.0, 0.0, yaw_rad))
    return _pseudo(known.poses.poses[anchor.lidar].inverse() @ of_root, anchor.stop)


def _pseudo(pose: RigidTransform, stop: str) -> ViewPair:
    """Return a pose as a pair without weight."""
    unknown = float("nan")
    pair = PairRegistration(
        pose.target, pose.source, pose, -np.inf, unknown, 0, None, None, "", verdict=Verdict("undecided")
    )
    return ViewPair(pair, stop, stop)


def _at_each_stop(views: Sequence[DriveView], poses: Mapping[str, RigidTransform]) -> list[ViewPair]:
    """Return the poses between LiDARs at each stop, as pairs without weight."""
    placed = sorted((view.stop, view.lidar) for view in views if view.lidar in poses)
    return [
        _pseudo(poses[lidar].inverse() @ poses[other], stop)
        for (stop, lidar), (other_stop, other) in pairwise(placed)
        if stop == other_stop
    ]


def _started(
    root: str,
    views: Sequence[DriveView],
    pairs: Sequence[ViewPair],
    assumed: Sequence[ViewPair],
    grounds: Sequence[ViewPair],
) -> ViewSolution:
    """Return the poses that chains of pairs tell, not fitted yet."""
    graph = ViewGraph.of(views, [*pairs, *assumed])
    poses, told = graph.lidar_poses(root), 0
    while told < len(poses):
        # A chain of LiDARs over several stops tells poses that hold at every stop.
        told = len(poses)
        graph = ViewGraph.of(views, [*pairs, *assumed, *_at_each_stop(views, poses)])
        poses = graph.lidar_poses(root)
    linked = graph.linked_stops(root, [pair for pair in pairs if pair.is_link])
    used = [pair for pair in pairs if not pair.is_link and pair.registration.lidars <= {*poses}] + [*linked.links]
    stops = {name: linked.poses[name] for link in linked.links for name in sorted(link.stops)}
    state = ViewPoses(poses, stops, sorted(poses.keys() - {root}), sorted(stops.keys() - linked.first))
    seen = ground_pairs_of(poses, grounds)
    return ViewSolution(state, used, linked.first, np.inf, np.zeros((state.columns, state.columns)), seen)


def _fits(lidar: str, starts: Sequence[ViewSolution]) -> list[ViewSolution]:
    """Fit all pairs from each start: roughly first, then the starts whose rough fit is good."""
    found: list[ViewSolution] = []
    for start in starts:
        rough = _fit(start, _ROUGHLY[0])
        if rough.squared > _ROUGH_FITTING * len(rough.pairs) or _is_afar(rough, lidar):
            continue
        fitted = _fit(_fit(rough, _ROUGHLY[1]))
        if not _is_afar(fitted, lidar):
            found.append(fitted)
    return found


def _fit(start: ViewSolution, error: FloatArray | None = None) -> ViewSolution:
    """Fit poses to all pairs (Levenberg-Marquardt).

    Args:
        error: covariance (6, 6) that each pair has besides its own.
    """
    poses = start.poses
    equations = PairEquations.of(poses, start.pairs, start.grounds, error)
    squared, information, gradient = equations.at(poses)
    damping, least_gain = 1e-3, _LEAST_GAIN if error is None else _LEAST_ROUGH_GAIN
    for _ in range(_ITERATIONS):
        if not poses.columns:
            break
        system = information + _prior(poses.columns)
        step = np.asarray(np.linalg.solve(system + damping * np.diag(np.diag(system)), -gradient), dtype=np.float64)
        further = poses.moved(step)
        after = equations.at(further)
        if after.squared > squared:
            damping *= 10.0
            if damping > 1e6:
                break
            continue
        is_settled = squared - after.squared < least_gain * squared
        poses, damping = further, damping / 4.0
        squared, information, gradient = after
        if is_settled or np.abs(step).max() < _EPSILON:
            break
    return replace(start, poses=poses, squared=squared, information=information)


def _prior(columns: int) -> FloatArray:
    return np.diag(np.resize(UNKNOWN, columns) ** -2.0)
