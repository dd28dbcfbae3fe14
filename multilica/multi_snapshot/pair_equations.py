# SPDX-License-Identifier: Apache-2.0
"""Equations of all pairs of views at once, for poses that fit them best."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from multilica.geometry import FloatArray, skew
from multilica.multi_snapshot.common_ground import vertical_of
from multilica.registration.view_poses import ViewPoses
from multilica.results import IndexArray, ViewPair

LARGEST_RESIDUAL = 6.0 * 3.0**2
"""Squared residuals beyond this, of 6 degrees of freedom, lose weight (Cauchy)."""


class Equations(NamedTuple):
    """Sum of the squared residuals with their robust loss, the information (N, N) and the gradient (N,)."""

    squared: float
    information: FloatArray
    gradient: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PairEquations:
    """Residuals of P pairs and their derivatives, as those of `ViewPoses` for one pair.

    Args:
        lidars, stops: (P, 2) numbers of the target's and the source's LiDAR and stop. The number after the last stop
            stands for both stops of a pair within one: its pose cancels.
        columns: (P, 2, 2, 6) of the unknowns of LiDAR and stop; those after the last unknown are of known poses.
        registered: (P, 4, 4) matrices of the pairs.
        weights: (P, 6, 6) inverse covariances of the residuals.
        verticals: (P, 3) unit axes of the target about which a pair tells no turn; 0 for pairs that tell all.
    """

    lidars: IndexArray
    stops: IndexArray
    columns: IndexArray
    registered: FloatArray
    weights: FloatArray
    verticals: FloatArray

    @classmethod
    def of(
        cls,
        poses: ViewPoses,
        pairs: Sequence[ViewPair],
        grounds: Sequence[ViewPair] = (),
        error: FloatArray | None = None,
    ) -> "PairEquations":
        """Prepare the equations of pairs.

        Args:
            poses: with the unknowns; their values do not matter.
            grounds: pairs of LiDARs that see the same ground, which tells no heading.
            error: covariance (6, 6) that each pair has besides its own.
        """
        verticals = [np.zeros(3)] * len(pairs) + [vertical_of(pair) for pair in grounds]
        pairs = [*pairs, *grounds]
        known = poses.columns
        of_lidar = {name: 6 * number for number, name in enumerate(poses.free)}
        of_stop: dict[str | None, int] = {
            name: 6 * number for number, name in enumerate(poses.free_stops, len(poses.free))
        }
        lidar_numbers = {name: number for number, name in enumerate(poses.poses)}
        stop_numbers = {name: number for number, name in enumerate(poses.stops)}
        lidars, stops, columns = [], [], []
        for pair in pairs:
            views = pair.target, pair.source
            moving = [view.stop if pair.is_link else None for view in views]
            lidars.append([lidar_numbers[view.lidar] for view in views])
            stops.append([len(stop_numbers) if stop is None else stop_numbers[stop] for stop in moving])
            columns.append(
                [
                    (of_lidar.get(view.lidar, known), of_stop.get(stop, known))
                    for view, stop in zip(views, moving, strict=True)
                ]
            )
        registered = np.array([pair.registration.T_target_source.matrix for pair in pairs]).reshape(-1, 4, 4)
        weights = np.array([pair.registration.information for pair in pairs]).reshape(-1, 6, 6)
        if error is not None:
            weights = weights @ np.linalg.inv(np.eye(6) + error @ weights)
        return cls(
            lidars=np.array(lidars, dtype=np.intp).reshape(-1, 2),
            stops=np.array(stops, dtype=np.intp).reshape(-1, 2),
            columns=np.array(columns, dtype=np.intp).reshape(-1, 2, 2, 1) + np.arange(6),
            registered=registered,
            weights=weights,
            verticals=np.reshape(verticals, (-1, 3)),
        )

    def at(self, poses: ViewPoses) -> Equations:
        """Return the sums over all pairs, each with its robust weight."""
        offsets, jacobians = self._linearised(poses)
        weighted = np.einsum("pij,pj->pi", self.weights, offsets)
        squared = np.einsum("pi,pi->p", offsets, weighted)
        robust = 1.0 / (1.0 + squared / LARGEST_RESIDUAL)
        flat = jacobians.reshape(6 * len(offsets), poses.columns)
        information = flat.T @ ((robust[:, None, None] * self.weights) @ jacobians).reshape(flat.shape)
        gradient = flat.T @ (robust[:, None] * weighted).ravel()
        total = LARGEST_RESIDUAL * float(np.sum(np.log1p(squared / LARGEST_RESIDUAL)))
        return Equations(total, np.asarray(information), np.asarray(gradient))

    def _linearised(self, poses: ViewPoses) -> tuple[FloatArray, FloatArray]:
        """Return the offsets (P, 6) of the poses from the pairs, and their derivatives (P, 6, N)."""
        of_lidars = np.array([pose.matrix for pose in poses.poses.values()])[self.lidars]
        of_stops = np.array([*(pose.matrix for pose in poses.stops.values()), np.eye(4)])[self.stops]
        stop_rotations, lidars_m = of_stops[..., :3, :3], of_lidars[..., :3, 3:]
        arms_m = (stop_rotations @ lidars_m)[..., 0]
        rotations, xyz_m = stop_rotations @ of_lidars[..., :3, :3], arms_m + of_stops[..., :3, 3]
        to_target = np.swapaxes(rotations[:, 0], 1, 2)
        apart_m = xyz_m[:, 1] - xyz_m[:, 0]
        turns = Rotation.from_matrix(to_target @ rotations[:, 1] @ np.swapaxes(self.registered[:, :3, :3], 1, 2))
        turned = _without_turn(turns, self.verticals)
        shifted_m = (to_target @ apart_m[..., None])[..., 0] - self.registered[:, :3, 3]

        by_views = np.zeros((len(self.lidars), 2, 6, 6))
        by_views[:, 0, :3, :3] = by_views[:, 0, 3:, 3:] = -to_target
        by_views[:, 1, :3, :3] = by_views[:, 1, 3:, 3:] = to_target
        by_views[:, 0, 3:, :3] = to_target @ skew(apart_m)
        by_lidars = (by_views.reshape(-1, 2, 6, 2, 3) @ stop_rotations[:, :, None]).reshape(by_views.shape)
        by_stops = by_views.copy()
        by_stops[..., :3] -= by_views[..., 3:] @ skew(arms_m)

        found = np.zeros((len(self.lidars), 6, poses.columns + 6))
        each, rows = np.ogrid[: len(self.lidars), :6]
        for side in range(2):
            for number, derivatives in enumerate((by_lidars, by_stops)):
                columns = self.columns[:, side, number]
                found[each[..., None], rows[..., None], columns[:, None]] += derivatives[:, side]
        return np.hstack([turned, shifted_m]), found[..., : poses.columns]


def _without_turn(rotations: Rotation, axes: FloatArray) -> FloatArray:
    """Return rotation vectors (P, 3) less the turn about an axis (P, 3) that comes first; an axis of 0 takes nothing.

    Derivatives hold for small residuals, and a turn that nothing tells may be half a one.
    """
    quaternions = rotations.as_quat()
    along = np.einsum("pi,pi->p", quaternions[:, :3], axes)
    first = Rotation.from_rotvec(2.0 * np.arctan2(along, quaternions[:, 3])[:, None] * axes)
    return np.asarray((rotations * first.inv()).as_rotvec())
