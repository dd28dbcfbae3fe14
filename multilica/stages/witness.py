# SPDX-License-Identifier: Apache-2.0
"""What sensors testify of each other's points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from multilica.config import VerifyConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.results import BoolArray, PreprocessedCloud
from multilica.stages.beam_image import BeamImage, BeamLabel, LabelArray, build_beam_image, label_points
from multilica.stages.point_tree import PointTree, principal_directions
from multilica.stages.voxel_grid import thin
from multilica.testimony import LEVER_ARM_M, Testimony

__all__ = ["PlacedWitness", "Trial", "Witness", "judge", "prepare_witness"]

_BAND_RAD = 0.05
_RETURN_VOXEL_M = 0.1
_SURFACE_NEIGHBOURS = 40
_SOLID_FLATNESS = 0.02
_PLANE_WIDTH = 0.05
_WIDER_THAN_THICK = 10.0
_OWN_BODY_M = 3.0
_CARRIED_M = 0.3
_THIN_M = 0.1
_PATCH_M = 0.5
_STRUCTURE = float(np.cos(np.deg2rad(45.0)))
_GRAZING = float(np.sin(np.deg2rad(15.0)))


@dataclass(frozen=True, slots=True, eq=False)
class Witness:
    """One sensor's testimony.

    Args:
        image: its beams; None if there are too few.
        probes_m: (N, 3) points in its own frame that other sensors are to judge.
        solid: (N,) which of them lie on a closed surface, not in foliage, on a fence or on something thin.
        normals: (N, 3) unit normals of the surface; zero where the neighbours do not span one.
        returns: its points, thinned: thin things that fall between the beams of the image are among them; None if
            there are none in range.
    """

    lidar: str
    image: BeamImage | None
    probes_m: FloatArray
    solid: BoolArray
    normals: FloatArray
    returns: PointTree | None


PlacedWitness = tuple[RigidTransform, Witness]
"""A witness with its pose in a group's root frame."""

Trial = Callable[[RigidTransform], Testimony]
"""What the beams of two LiDARs say of a pose between them."""


def prepare_witness(cloud: PreprocessedCloud, config: VerifyConfig) -> Witness:
    """Everything of one sensor that every hypothesis about it needs."""
    near_m = cloud.points_m[np.linalg.norm(cloud.points_m, axis=1) <= config.max_range_m]
    probes_m = _along_bands(thin(near_m, config.probe_voxel_size_m))
    image = build_beam_image(cloud.returns_m)
    returns = PointTree(thin(near_m, _RETURN_VOXEL_M)) if len(near_m) else None
    flat, normals = _surfaces(probes_m, returns)
    return Witness(cloud.lidar, image, probes_m, flat & _opaque(image, probes_m, config), normals, returns)


def judge(
    targets: Sequence[PlacedWitness],
    sources: Sequence[PlacedWitness],
    T_target_source: RigidTransform,
    tolerance_m: float,
    tolerance_deg: float,
) -> Testimony:
    """Let the beams of each side judge the probes of the other, over all pairs of members.

    Args:
        targets, sources: the members of both groups with their poses in their group's root; one each for a pair.
        T_target_source: the pose on trial, between the two roots.
        tolerance_m, tolerance_deg: see `label_points`.

    Returns:
        Counts over both directions, with the labels that the first target and the first source give each other.
    """
    ballots: list[_Ballot] = []
    shown: tuple[LabelArray, LabelArray] | None = None
    seen_through_m = 0.0
    for T_target_member, target in targets:
        for T_source_member, source in sources:
            T_target_placed = T_target_source @ T_source_member
            pose = T_target_member.inverse() @ T_target_placed
            forth = _labels(target, source, pose, tolerance_m, tolerance_deg)
            back = _labels(source, target, pose.inverse(), tolerance_m, tolerance_deg)
            if _sees_through(target, pose, tolerance_m, tolerance_deg) or _sees_through(
                source, pose.inverse(), tolerance_m, tolerance_deg
            ):
                seen_through_m = max(seen_through_m, float(np.linalg.norm(pose.xyz_m)))
            ballots.append(_ballot(source, forth, T_target_placed))
            ballots.append(_ballot(target, back, T_target_member))
            shown = (forth, back) if shown is None else shown
    counts = _counts(np.concatenate([ballot.labels for ballot in ballots]))
    information = sum((_information(ballot, T_target_source.xyz_m) for ballot in ballots), start=np.zeros((6, 6)))
    commonest = np.linalg.eigh(information[3:, 3:])[1][:, -1]
    structure = _counts(np.concatenate([_structure(ballot, commonest) for ballot in ballots]))
    nothing = np.zeros(0, dtype=np.uint8)
    labels, target_labels = (nothing, nothing) if shown is None else shown
    return Testimony(
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
        seen_through_m=seen_through_m,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Ballot:
    """One sensor's probes in the target group's frame, with what the beams of another say of each."""

    labels: LabelArray
    points_m: FloatArray
    normals: FloatArray
    solid: BoolArray


def _ballot(witness: Witness, labels: LabelArray, T_root_witness: RigidTransform) -> _Ballot:
    return _Ballot(
        labels, T_root_witness.apply(witness.probes_m), T_root_witness.rotate(witness.normals), witness.solid
    )


def _counts(labels: LabelArray) -> list[int]:
    return [int(count) for count in np.bincount(labels, minlength=len(BeamLabel))]


def _information(ballot: _Ballot, centre_m: FloatArray) -> FloatArray:
    """Sum of J J^T over agreeing points: how a small turn and shift of the pose would lift them off their surfaces."""
    agree = ballot.labels == BeamLabel.AGREE
    normals = ballot.normals[agree]
    arms = ballot.points_m[agree] - centre_m
    jacobian = np.concatenate([np.cross(arms, normals) / LEVER_ARM_M, normals], axis=1)
    return np.asarray(jacobian.T @ jacobian)


def _structure(ballot: _Ballot, commonest: FloatArray) -> LabelArray:
    """The labels of closed surfaces whose orientation is not the commonest one."""
    apart = np.abs(ballot.normals @ commonest) < _STRUCTURE
    return np.asarray(ballot.labels[ballot.solid & np.any(ballot.normals, axis=1) & apart])


def _labels(
    beams: Witness, other: Witness, T_beams_other: RigidTransform, tolerance_m: float, tolerance_deg: float
) -> LabelArray:
    """What a sensor's beams say of the other's probes.

    What is not solid cannot violate, beams pass through it; nor can a surface seen at a grazing angle, beams pass
    beside it; nor what the sensor has a return from itself, a pole or an edge that the beams beside it missed; nor what
    is so narrow that it can stand between two beams.
    """
    if beams.image is None:
        return np.full(len(other.probes_m), BeamLabel.UNSEEN, dtype=np.uint8)
    points_m = T_beams_other.apply(other.probes_m)
    spanned = np.any(other.normals, axis=1)
    widths_m = np.where(spanned, _PATCH_M, _THIN_M)
    labels = label_points(beams.image, points_m, tolerance_m, float(np.deg2rad(tolerance_deg)), widths_m)
    facing = np.abs(np.einsum("ij,ij->i", T_beams_other.rotate(other.normals), points_m))
    grazing = (facing < _GRAZING * np.linalg.norm(points_m, axis=1)) & spanned
    labels[(labels == BeamLabel.VIOLATE) & (grazing | ~other.solid)] = BeamLabel.OCCLUDED
    empty = np.flatnonzero(labels == BeamLabel.VIOLATE)
    if beams.returns is None or len(empty) == 0:
        return labels
    reach_m = 2.0 * (tolerance_m + np.deg2rad(tolerance_deg) * np.linalg.norm(points_m[empty], axis=1))
    nearest_m, _ = beams.returns.nearest(points_m[empty])
    labels[empty[nearest_m <= reach_m]] = BeamLabel.AGREE
    return labels


def _sees_through(beams: Witness, T_beams_other: RigidTransform, tolerance_m: float, tolerance_deg: float) -> bool:
    """Whether beams pass through all around the place of another sensor, which nothing would carry there.

    Over the vehicle's own body, near by, beams may graze what carries it.
    """
    place_m = T_beams_other.xyz_m
    if beams.image is None or float(np.linalg.norm(place_m)) < _OWN_BODY_M:
        return False
    around_m = place_m + _CARRIED_M * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    labels = label_points(beams.image, around_m, tolerance_m, float(np.deg2rad(tolerance_deg)))
    return bool(np.all(labels == BeamLabel.VIOLATE))


def _along_bands(points_m: FloatArray) -> FloatArray:
    """In bands of elevation, back and forth: what lies beside a point in view comes after it, and is found at once."""
    elevation_rad = np.arctan2(points_m[:, 2], np.linalg.norm(points_m[:, :2], axis=1))
    azimuth_rad = np.arctan2(points_m[:, 1], points_m[:, 0])
    band = np.floor(elevation_rad / _BAND_RAD)
    return np.asarray(points_m[np.lexsort((np.where(band % 2 == 0, azimuth_rad, -azimuth_rad), band))])


def _opaque(image: BeamImage | None, probes_m: FloatArray, config: VerifyConfig) -> BoolArray:
    """Which probes the sensor's own beams confirm: of a fence or a pole, most beams nearby see what is behind it."""
    if image is None:
        return np.zeros(len(probes_m), dtype=bool)
    own = label_points(image, probes_m, config.tolerance_m, float(np.deg2rad(config.tolerance_deg)))
    return np.asarray(own == BeamLabel.AGREE)


def _surfaces(probes_m: FloatArray, returns: PointTree | None) -> tuple[BoolArray, FloatArray]:
    """Which probes have flat surroundings, as surfaces have and foliage has not, with their normals.

    The surroundings are thinned: in a dense cloud the nearest points lie within the range noise of each other.
    Neighbours on one line, a single ring of a sparse sensor, are flat yet have no normal.
    """
    if returns is None:
        return np.zeros(0, dtype=bool), np.zeros((0, 3))
    neighbours = returns.neighbours(probes_m, _SURFACE_NEIGHBOURS)
    variances, axes = principal_directions(returns.points_m, neighbours)
    solid = np.asarray(variances[:, 0] <= _SOLID_FLATNESS * variances.sum(axis=1))
    wide = variances[:, 1] >= np.maximum(_PLANE_WIDTH * variances[:, 2], _WIDER_THAN_THICK * variances[:, 0])
    spanned = solid & wide
    return solid, np.where(spanned[:, None], axes[:, :, 0], 0.0)
