# SPDX-License-Identifier: Apache-2.0
"""Views of sensors, and scores of poses between them by free space."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from multilica.geometry import LEVER_ARM_M, FloatArray, RigidTransform, lengths
from multilica.registration.neighbours import PointTree, spread_and_normals, thin
from multilica.results import (
    BeamLabel,
    BoolArray,
    Hypothesis,
    PairRegistration,
    PreprocessedCloud,
    Registration,
    VisibilityScore,
)
from multilica.visibility.range_image import LabelArray, RangeImage, build_range_image, label_points

# Height of the bands in which probes are ordered; any value gives the same scores.
_BAND_RAD = 0.05
# Twice the range noise of spinning LiDARs, so that neighbours span a surface and not its noise.
_RETURN_VOXEL_M = 0.1
_SURFACE_NEIGHBOURS = 40
# Share of the variance across the surface: walls measure below 1 %, foliage above 5 %.
_SOLID_FLATNESS = 0.02
# A surface rather than a single ring: extent across the ring, against along it and against the noise.
_PLANE_WIDTH = 0.05
_WIDER_THAN_THICK = 10.0
# Width of poles and branches, and of the patch that a surface probe stands for (the voxel of the probes).
_THIN_M = 0.1
_PATCH_M = _PROBE_VOXEL_M = 0.5
# Points beyond are left out.
_MAX_RANGE_M = 50.0
_STRUCTURE = float(np.cos(np.deg2rad(45.0)))
_GRAZING = float(np.sin(np.deg2rad(15.0)))

ROUGH_TOLERANCES = (0.15, 0.5)
"""Metres and degrees: a point nearer than this to a measured surface lies on it; the degrees are a rotation's error."""
COMPETING_TOLERANCES = (0.6, ROUGH_TOLERANCES[1])
"""The same for poses that may compete: they come from plans with cells of 0.5 m, or from steps of 1 m."""
FINE_TOLERANCES = (0.08, 0.2)
"""The same after the fine registration."""


@dataclass(frozen=True, slots=True, eq=False)
class SensorView:
    """The view of one sensor, prepared for scoring poses.

    Args:
        image: its beams; None if there are too few.
        probes_m: (N, 3) points in its own frame that the beams of others label.
        solid: (N,) which of them lie on a closed surface, not in foliage, on a fence or on something thin.
        normals: (N, 3) unit normals; zero where the neighbours span no surface.
        spanned: (N,) which normals are not zero.
        returns: tree of its thinned points, which include thin things between the beams of the image; None if there
            are none in range.
        movable: (N,) which probes lie on objects that may have stood elsewhere when the others were measured: their
            points cannot violate. None: no probe does.
        at_stop: whether the views that it is scored with are of other stops of the vehicle's drive.
    """

    lidar: str
    image: RangeImage | None
    probes_m: FloatArray
    solid: BoolArray
    normals: FloatArray
    spanned: BoolArray
    returns: cKDTree | None
    movable: BoolArray | None = None
    at_stop: bool = False

    @property
    def alone(self) -> "list[PlacedView]":
        """The only member of a group."""
        return [(RigidTransform.identity(self.lidar, self.lidar), self)]


PlacedView = tuple[RigidTransform, SensorView]
"""A view with its pose in a group's root frame."""

ScorePose = Callable[[RigidTransform], Registration]
"""Scores a pose between two LiDARs by their beams."""


def prepare_sensor_view(cloud: PreprocessedCloud) -> SensorView:
    """Prepare what every hypothesis about a sensor needs."""
    near_m = cloud.points_m[lengths(cloud.points_m) <= _MAX_RANGE_M]
    probes_m = _along_bands(thin(near_m, _PROBE_VOXEL_M))
    image = build_range_image(cloud.returns_m)
    returns_m = thin(near_m, _RETURN_VOXEL_M)
    solid, normals, spanned = _surfaces(probes_m, returns_m)
    if image is None:
        solid = np.zeros(len(probes_m), dtype=bool)
    else:
        # Around a fence or a pole, most of the sensor's own beams see what is behind.
        tolerance_m, tolerance_deg = ROUGH_TOLERANCES
        own = label_points(image, probes_m, tolerance_m, float(np.deg2rad(tolerance_deg)))
        solid &= own == BeamLabel.AGREE
    returns = cKDTree(returns_m, balanced_tree=False, compact_nodes=False) if len(returns_m) else None
    return SensorView(cloud.lidar, image, probes_m, solid, normals, spanned, returns)


def score_visibility(
    targets: Sequence[PlacedView],
    sources: Sequence[PlacedView],
    T_target_source: RigidTransform,
    tolerance_m: float,
    tolerance_deg: float,
    first: LabelArray | None = None,
) -> VisibilityScore:
    """Label the probes of each side by the beams of the other, over all pairs of members.

    Args:
        targets, sources: the members of both groups with their poses in their group's root; one each for a pair.
        T_target_source: the pose to score, between the two roots.
        tolerance_m, tolerance_deg: see `label_points`.
        first: labels of the first source by the first target, if they are known.

    Returns:
        Counts over both directions, with the labels between the first target and the first source.
    """
    labelled: list[_Labelled] = []
    shown: tuple[LabelArray, LabelArray] | None = None
    for T_target_member, target in targets:
        for T_source_member, source in sources:
            T_target_placed = T_target_source @ T_source_member
            pose = T_target_member.inverse() @ T_target_placed
            known = first if shown is None else None
            forth = _labels(target, source, pose, tolerance_m, tolerance_deg) if known is None else known
            back = _labels(source, target, pose.inverse(), tolerance_m, tolerance_deg)
            labelled.append(_Labelled(source, forth, T_target_placed))
            labelled.append(_Labelled(target, back, T_target_member))
            shown = (forth, back) if shown is None else shown
    all_labels = np.concatenate([probes.labels for probes in labelled])
    counts = _counts(all_labels)
    normals = np.concatenate([probes.T_root_view.rotate(probes.view.normals) for probes in labelled])
    agreeing = np.flatnonzero((all_labels == BeamLabel.AGREE) & normals.any(axis=1))
    information = sum((_information(probes, T_target_source.xyz_m) for probes in labelled), start=np.zeros((6, 6)))
    commonest = np.linalg.eigh(information[3:, 3:])[1][:, -1]
    structure = _counts(np.concatenate([_structure(probes, commonest) for probes in labelled]))
    nothing = np.zeros(0, dtype=np.uint8)
    labels, target_labels = (nothing, nothing) if shown is None else shown
    return VisibilityScore(
        agree=counts[BeamLabel.AGREE],
        violate=counts[BeamLabel.VIOLATE],
        occluded=counts[BeamLabel.OCCLUDED],
        unseen=counts[BeamLabel.UNSEEN],
        information=information,
        labels=labels,
        structure_agree=structure[BeamLabel.AGREE],
        structure_violate=structure[BeamLabel.VIOLATE],
        structure_occluded=structure[BeamLabel.OCCLUDED],
        target_labels=target_labels,
        violating=all_labels == BeamLabel.VIOLATE,
        agreeing=agreeing.astype(np.int32),
        agreeing_normals=normals[agreeing].astype(np.float16),
        between_stops=any(view.at_stop for _, view in (*targets, *sources)),
    )


def score_registration(
    found: PairRegistration,
    hypothesis: Hypothesis,
    targets: Sequence[PlacedView],
    sources: Sequence[PlacedView],
    tolerance_m: float,
    tolerance_deg: float,
) -> Registration:
    """Score a registered pose as `score_visibility` does; `hypothesis` is where the registration started."""
    return Registration(
        hypothesis=hypothesis.index,
        T_target_source=found.T_target_source,
        visibility=score_visibility(targets, sources, found.T_target_source, tolerance_m, tolerance_deg),
        fitness=found.fitness,
        rmse_m=found.rmse_m,
        weakest_curvature=_weakest_curvature(found),
        probes_m=sources[0][1].probes_m,
        origin=hypothesis.origin,
        target_probes_m=targets[0][1].probes_m,
        derivation=hypothesis.derivation,
    )


def score_pose(
    target: SensorView, source: SensorView, T_target_source: RigidTransform, tolerance_m: float, tolerance_deg: float
) -> Registration:
    """Score a pose of two LiDARs that was not registered."""
    score = score_visibility(target.alone, source.alone, T_target_source, tolerance_m, tolerance_deg)
    unknown = float("nan")
    return Registration(
        -1, T_target_source, score, unknown, unknown, unknown, source.probes_m, target_probes_m=target.probes_m
    )


def may_compete(
    target: SensorView,
    source: SensorView,
    T_target_source: RigidTransform,
    best: Registration,
    least: float,
    tolerance_m: float,
    tolerance_deg: float,
) -> bool:
    """Return whether a pose has more than the least evidence beside the best one of the pair.

    For most poses, the beams of one LiDAR are enough to tell that it has not.
    """
    distance_m = float(np.linalg.norm(T_target_source.xyz_m))
    labels = _labels(target, source, T_target_source, tolerance_m, tolerance_deg)
    counts = _counts(labels)
    of_one = VisibilityScore(
        agree=counts[BeamLabel.AGREE],
        violate=counts[BeamLabel.VIOLATE],
        occluded=counts[BeamLabel.OCCLUDED],
        unseen=counts[BeamLabel.UNSEEN],
        information=np.zeros((6, 6)),
        labels=labels,
        violating=labels == BeamLabel.VIOLATE,
        between_stops=target.at_stop or source.at_stop,
    )
    if of_one.most_beside(best.visibility, distance_m, len(target.probes_m)) <= least:
        return False
    of_both = score_visibility(target.alone, source.alone, T_target_source, tolerance_m, tolerance_deg, labels)
    return of_both.evidence_beside(best.visibility, distance_m) > least


@dataclass(frozen=True, slots=True, eq=False)
class _Labelled:
    """Probes of one sensor with the labels of another's beams, and their pose in the target group's frame."""

    view: SensorView
    labels: LabelArray
    T_root_view: RigidTransform


def _counts(labels: LabelArray) -> list[int]:
    return [int(count) for count in np.bincount(labels, minlength=len(BeamLabel))]


def _information(probes: _Labelled, centre_m: FloatArray) -> FloatArray:
    """Sum J J^T over agreeing points; J is the derivative of the point-to-plane distance by the pose."""
    agree = np.flatnonzero(probes.labels == BeamLabel.AGREE)
    arms = (probes.T_root_view.apply(probes.view.probes_m[agree]) - centre_m) / LEVER_ARM_M
    (x, y, z), (nx, ny, nz) = arms.T, probes.T_root_view.rotate(probes.view.normals[agree]).T
    jacobian = np.stack([y * nz - z * ny, z * nx - x * nz, x * ny - y * nx, nx, ny, nz])
    return np.asarray(jacobian @ jacobian.T)


def _structure(probes: _Labelled, commonest: FloatArray) -> LabelArray:
    """Select the labels of closed surfaces off the commonest orientation."""
    view = probes.view
    apart = np.abs(view.normals @ (probes.T_root_view.rotation.T @ commonest)) < _STRUCTURE
    return np.asarray(probes.labels[view.solid & view.spanned & apart])


def _labels(
    beams: SensorView, other: SensorView, T_beams_other: RigidTransform, tolerance_m: float, tolerance_deg: float
) -> LabelArray:
    """Label the probes of one sensor by the beams of the other.

    Four kinds of points cannot violate: points that are not solid (beams pass through), surfaces at a grazing angle
    (beams pass beside), points that the sensor has a return from itself (poles and edges between its beams), and
    things narrow enough to stand between two beams.
    """
    if beams.image is None:
        return np.full(len(other.probes_m), BeamLabel.UNSEEN, dtype=np.uint8)
    points_m = T_beams_other.apply(other.probes_m)
    widths_m = np.where(other.spanned, _PATCH_M, _THIN_M)
    labels = label_points(beams.image, points_m, tolerance_m, float(np.deg2rad(tolerance_deg)), widths_m)
    if other.movable is not None:
        labels[(labels == BeamLabel.VIOLATE) & other.movable] = BeamLabel.UNSEEN
    empty = np.flatnonzero(labels == BeamLabel.VIOLATE)
    if len(empty) == 0:
        return labels
    range_m = lengths(points_m[empty])
    facing = np.abs(np.einsum("ij,ij->i", T_beams_other.rotate(other.normals[empty]), points_m[empty]))
    passed = ((facing < _GRAZING * range_m) & other.spanned[empty]) | ~other.solid[empty]
    labels[empty[passed]] = BeamLabel.OCCLUDED
    empty, range_m = empty[~passed], range_m[~passed]
    if beams.returns is None or len(empty) == 0:
        return labels
    reach_m = 2.0 * (tolerance_m + np.deg2rad(tolerance_deg) * range_m)
    nearest_m, _ = beams.returns.query(points_m[empty], distance_upper_bound=np.nextafter(reach_m.max(), np.inf))
    labels[empty[nearest_m <= reach_m]] = BeamLabel.AGREE
    return labels


def _weakest_curvature(registration: PairRegistration) -> float:
    """Return the smallest eigenvalue of the GICP Hessian per inlier, rotations scaled by `LEVER_ARM_M`; NaN without."""
    if registration.hessian is None:
        return float("nan")
    inliers = registration.steps[-1].inliers if registration.steps else 0
    if inliers == 0:
        return 0.0
    scale = np.repeat([1.0 / LEVER_ARM_M, 1.0], 3)
    return float(np.linalg.eigvalsh(registration.hessian * np.outer(scale, scale) / inliers)[0])


def _along_bands(points_m: FloatArray) -> FloatArray:
    """Order points in bands of elevation, back and forth: neighbours in view follow each other, so lookups are fast."""
    elevation_rad = np.arctan2(points_m[:, 2], np.linalg.norm(points_m[:, :2], axis=1))
    azimuth_rad = np.arctan2(points_m[:, 1], points_m[:, 0])
    band = np.floor(elevation_rad / _BAND_RAD)
    return np.asarray(points_m[np.lexsort((np.where(band % 2 == 0, azimuth_rad, -azimuth_rad), band))])


def _surfaces(probes_m: FloatArray, returns_m: FloatArray) -> tuple[BoolArray, FloatArray, BoolArray]:
    """Find the probes that have flat surroundings, unlike foliage, and return their normals, and which have one.

    The surroundings are thinned: in a dense cloud the nearest points lie within the range noise of each other.
    Neighbours on one line, a single ring of a sparse sensor, are flat but have no normal.
    """
    if len(returns_m) == 0:
        return np.zeros(0, dtype=bool), np.zeros((0, 3)), np.zeros(0, dtype=bool)
    neighbours = PointTree(returns_m).neighbours(probes_m, _SURFACE_NEIGHBOURS)
    variances, normals = spread_and_normals(returns_m, neighbours)
    solid = np.asarray(variances[:, 0] <= _SOLID_FLATNESS * variances.sum(axis=1))
    wide = variances[:, 1] >= np.maximum(_PLANE_WIDTH * variances[:, 2], _WIDER_THAN_THICK * variances[:, 0])
    spanned = solid & wide
    return solid, np.where(spanned[:, None], normals, 0.0), spanned
