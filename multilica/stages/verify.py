# SPDX-License-Identifier: Apache-2.0
"""Judge hypotheses by what the beams of both sensors prove."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multilica.config import FineConfig, VerifyConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.results import Assessment, CoarseResult, PairRegistration, PreprocessedCloud
from multilica.stages.beam_image import BeamImage, BeamLabel, LabelArray, build_beam_image, label_points
from multilica.stages.gicp import register_narrower
from multilica.stages.registration_cloud import RegistrationCloud, prepare_registration_cloud
from multilica.stages.voxel_grid import thin

__all__ = ["Witness", "assess_hypotheses", "assess_pose", "prepare_witness", "short_gicp", "weakest_curvature"]

SAME_POSE_M = 0.3
"""Refined poses nearer than this, and than `SAME_POSE_RAD`, are one answer."""
SAME_POSE_RAD = float(np.deg2rad(3.0))

ROTATION_SCALE_M = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Witness:
    """One sensor's testimony: its beams, the points that others are to judge, a thinned cloud for GICP."""

    lidar: str
    image: BeamImage | None
    probes_m: FloatArray
    cloud: RegistrationCloud


def prepare_witness(cloud: PreprocessedCloud, config: VerifyConfig, fine: FineConfig, threads: int) -> Witness:
    """Everything of one sensor that every hypothesis about it needs."""
    near_m = cloud.points_m[np.linalg.norm(cloud.points_m, axis=1) <= config.max_range_m]
    return Witness(
        lidar=cloud.lidar,
        image=build_beam_image(cloud.returns_m),
        probes_m=thin(near_m, config.probe_voxel_size_m),
        cloud=prepare_registration_cloud(cloud.lidar, near_m, short_gicp(config, fine), threads),
    )


def short_gicp(config: VerifyConfig, fine: FineConfig) -> FineConfig:
    """The settings of the short GICP: coarse grid, few iterations, loose convergence."""
    return fine.model_copy(
        update={
            "engine": "small_gicp",
            "voxel_size_m": config.voxel_size_m,
            "max_correspondence_distances_m": (2.0, 1.0, 0.5),
            "max_iterations": config.max_iterations,
            "translation_epsilon_m": 1e-3,
            "rotation_epsilon_rad": 1e-3,
            "fitness_distance_m": 0.5,
        }
    )


def assess_hypotheses(
    target: Witness, source: Witness, coarse: CoarseResult, config: VerifyConfig, gicp: FineConfig, threads: int
) -> tuple[Assessment, ...]:
    """Give each hypothesis a short GICP, then ask the beams of both sensors.

    A beam that returned from 20 m proves that the 20 m before it are empty: points that a pose puts there violate,
    points that it puts on measured surfaces agree, points behind surfaces say nothing. Hypotheses that start where
    an earlier one passed are the same answer and cost nothing.

    Args:
        gicp: the settings that `short_gicp` gave when the witnesses were prepared.

    Returns:
        The distinct answers, the most believable first.
    """
    found: list[Assessment] = []
    for index, hypothesis in enumerate(coarse.hypotheses):
        start = hypothesis.T_target_source
        if any(_same(start, other.T_target_source) for other in found):
            continue
        assessment = assess_pose(target, source, start, index, config, gicp, threads)
        if not any(_same(assessment.T_target_source, other.T_target_source) for other in found):
            found.append(assessment)
    return tuple(sorted(found, key=lambda assessment: -assessment.score))


def assess_pose(
    target: Witness,
    source: Witness,
    T_target_source: RigidTransform,
    hypothesis: int,
    config: VerifyConfig,
    gicp: FineConfig,
    threads: int,
) -> Assessment:
    """Refine one pose by the short GICP, then judge it."""
    registration = register_narrower(target.cloud, source.cloud, T_target_source, gicp, threads)
    pose = registration.T_target_source
    if registration.target != target.lidar:
        pose = pose.inverse()
    tolerance_rad = float(np.deg2rad(config.tolerance_deg))
    in_target = _labels(target.image, pose.apply(source.probes_m), config.tolerance_m, tolerance_rad)
    in_source = _labels(source.image, pose.inverse().apply(target.probes_m), config.tolerance_m, tolerance_rad)
    counts = np.bincount(in_target, minlength=len(BeamLabel)) + np.bincount(in_source, minlength=len(BeamLabel))
    return Assessment(
        hypothesis=hypothesis,
        T_target_source=pose,
        agree=int(counts[BeamLabel.AGREE]),
        violate=int(counts[BeamLabel.VIOLATE]),
        occluded=int(counts[BeamLabel.OCCLUDED]),
        unseen=int(counts[BeamLabel.UNSEEN]),
        fitness=registration.fitness,
        rmse_m=registration.rmse_m,
        weakest_curvature=weakest_curvature(registration),
        probes_m=source.probes_m,
        labels=in_target,
    )


def weakest_curvature(registration: PairRegistration) -> float:
    """Smallest eigenvalue of the Hessian per inlier, in units where 10 m of lever arm make a rotation a length."""
    inliers = registration.steps[-1].inliers if registration.steps else 0
    if registration.hessian is None or inliers == 0:
        return 0.0
    scale = np.repeat([1.0 / ROTATION_SCALE_M, 1.0], 3)
    return float(np.linalg.eigvalsh(registration.hessian * np.outer(scale, scale) / inliers)[0])


def _labels(image: BeamImage | None, points_m: FloatArray, tolerance_m: float, tolerance_rad: float) -> LabelArray:
    if image is None:
        return np.full(len(points_m), BeamLabel.UNSEEN, dtype=np.uint8)
    return label_points(image, points_m, tolerance_m, tolerance_rad)


def _same(pose: RigidTransform, other: RigidTransform) -> bool:
    metres, radians = pose.distance_to(other)
    return metres <= SAME_POSE_M and radians <= SAME_POSE_RAD
