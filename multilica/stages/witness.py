# SPDX-License-Identifier: Apache-2.0
"""What sensors testify of each other's points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from multilica.config import VerifyConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.results import BoolArray, PreprocessedCloud, Testimony
from multilica.stages.beam_image import BeamImage, BeamLabel, LabelArray, build_beam_image, label_points
from multilica.stages.voxel_grid import thin

__all__ = ["PlacedWitness", "Witness", "judge", "prepare_witness"]

_SOLID_NEIGHBOURS = 30
_SOLID_FLATNESS = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Witness:
    """One sensor's testimony.

    Args:
        image: its beams; None if there are too few.
        probes_m: (N, 3) points in its own frame that other sensors are to judge.
        solid: (N,) which of them lie on a surface rather than in foliage.
    """

    lidar: str
    image: BeamImage | None
    probes_m: FloatArray
    solid: BoolArray


PlacedWitness = tuple[RigidTransform, Witness]
"""A witness with its pose in a group's root frame."""


def prepare_witness(cloud: PreprocessedCloud, config: VerifyConfig) -> Witness:
    """Everything of one sensor that every hypothesis about it needs."""
    near_m = cloud.points_m[np.linalg.norm(cloud.points_m, axis=1) <= config.max_range_m]
    probes_m = thin(near_m, config.probe_voxel_size_m)
    return Witness(cloud.lidar, build_beam_image(cloud.returns_m), probes_m, _solid(probes_m, near_m))


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
        Counts over both directions, with the labels of the first source's probes by the first target.
    """
    counts = np.zeros(len(BeamLabel), dtype=np.int64)
    shown: LabelArray | None = None
    for T_target_member, target in targets:
        for T_source_member, source in sources:
            pose = T_target_member.inverse() @ T_target_source @ T_source_member
            forth = _labels(target, source, pose, tolerance_m, tolerance_deg)
            back = _labels(source, target, pose.inverse(), tolerance_m, tolerance_deg)
            counts += np.bincount(forth, minlength=len(BeamLabel)) + np.bincount(back, minlength=len(BeamLabel))
            shown = forth if shown is None else shown
    return Testimony(
        agree=int(counts[BeamLabel.AGREE]),
        violate=int(counts[BeamLabel.VIOLATE]),
        occluded=int(counts[BeamLabel.OCCLUDED]),
        unseen=int(counts[BeamLabel.UNSEEN]),
        labels=np.zeros(0, dtype=np.uint8) if shown is None else shown,
    )


def _labels(
    beams: Witness, other: Witness, T_beams_other: RigidTransform, tolerance_m: float, tolerance_deg: float
) -> LabelArray:
    """What a sensor's beams say of the other's probes; foliage cannot violate, beams pass through it."""
    if beams.image is None:
        return np.full(len(other.probes_m), BeamLabel.UNSEEN, dtype=np.uint8)
    labels = label_points(
        beams.image, T_beams_other.apply(other.probes_m), tolerance_m, float(np.deg2rad(tolerance_deg))
    )
    labels[(labels == BeamLabel.VIOLATE) & ~other.solid] = BeamLabel.OCCLUDED
    return labels


def _solid(probes_m: FloatArray, points_m: FloatArray) -> BoolArray:
    """Which probes have flat surroundings, as surfaces have and foliage has not."""
    if len(probes_m) == 0:
        return np.zeros(0, dtype=bool)
    _, index = cKDTree(points_m).query(probes_m, k=min(_SOLID_NEIGHBOURS, len(points_m)))
    around = points_m[index.reshape(len(probes_m), -1)]
    centred = around - around.mean(axis=1, keepdims=True)
    variances = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", centred, centred))
    return np.asarray(variances[:, 0] <= _SOLID_FLATNESS * variances.sum(axis=1))
