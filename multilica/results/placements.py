# SPDX-License-Identifier: Apache-2.0
"""Placements of LiDARs and of the ground, with the merge and the joint refinement that lead to them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from multilica.geometry import FloatArray, RigidTransform
from multilica.results.hypotheses import PairKey
from multilica.results.registrations import Registration
from multilica.results.values import Figure, Source, Target, Vector3, not_in_document

PlacementStatus = Literal["placed", "uncertain", "not_placed"]
"""Uncertain: one pose stands alone and uncontradicted, but its standard deviation is above the limit."""

SigmaOrigin = Literal["residuals", "snapshots"]
"""Basis of a covariance: the residuals of the registrations, or these widened to the spread over snapshots."""


LEAST_PROBABILITY = 0.001
"""Less probable disagreements are contradictions."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundPlane:
    """The ground seen from the target LiDAR; `GroundEntry` describes further fields.

    Args:
        normal: (3,) unit, upwards, in the target frame.
        offset_m: ``normal @ p + offset_m == 0`` on the plane, so the target LiDAR's height above ground.
        T_base_target: the target LiDAR in an ISO 8855 base frame on the ground: roll, pitch and z from the plane; x, y
            and yaw from a rig file, else zero.
        inlier_share: share of the merged cloud near the vehicle, by the area that it covers, that is ground.
        sigma_roll_pitch_deg: (2,) of the rotation about the base's x and y.
        T_base_target_rig: the pose of the target as the rig file has it.
    """

    normal: FloatArray
    offset_m: float
    T_base_target: RigidTransform
    inlier_share: float
    area_m2: float
    residual_m: float
    sigma_z_m: float
    sigma_roll_pitch_deg: FloatArray
    doubt: str = ""
    T_base_target_rig: RigidTransform | None = None

    @property
    def frame(self) -> str:
        """Name of the base frame."""
        return self.T_base_target.target

    @property
    def text(self) -> str:
        """The plane in sentences for people, without the last full stop."""
        roll_deg, pitch_deg, _ = self.T_base_target.rpy_deg
        above = f"{self.T_base_target.source} is {self.offset_m:.3f} m above it"
        parts = [
            f"{above}, with roll {roll_deg:z.2f} deg and pitch {pitch_deg:z.2f} deg",
            f"Sigma is {1e3 * self.sigma_z_m:.1f} mm and {self.sigma_roll_pitch_deg.max():.3f} deg",
            f"{self.area_m2:.0f} m2 are seen, {1e3 * self.residual_m:.1f} mm from smooth",
        ]
        if self.T_base_target_rig is not None:
            off_m = self.T_base_target_rig.xyz_m[2] - self.offset_m
            up = self.T_base_target_rig.rotation[2]
            tilt_deg = np.rad2deg(2.0 * np.arcsin(min(1.0, float(np.linalg.norm(up - self.normal)) / 2.0)))
            parts.append(f"The rig file is off by {1e3 * off_m:+.0f} mm, {tilt_deg:.2f} deg")
        parts += [f"UNCERTAIN: {self.doubt}"] if self.doubt else []
        return ". ".join(parts)


@dataclass(frozen=True, slots=True)
class Spread:
    """Scatter of the pose over several snapshots."""

    snapshots: Annotated[int, Field(description="Number of snapshots that place the LiDAR.")]
    xyz_m: Annotated[
        Vector3 | None, Field(description="Sample sigma along the axes of the target; null below two snapshots.")
    ] = None
    rotation_deg: Annotated[
        Vector3 | None, Field(description="Sample sigma about these axes; null below two snapshots.")
    ] = None


@dataclass(frozen=True, slots=True)
class PoseConflict:
    """A contradiction between one snapshot and others on one pair of LiDARs.

    Args:
        lidars: the pair, in name order.
        others: the snapshots that contradict it.
        distance_m, angle_deg: between its pose of the pair and that of the first of the others.
        outvoted: whether more than half of the contradicting snapshots agree on another pose.
    """

    snapshot: str
    lidars: PairKey
    others: tuple[str, ...]
    distance_m: float
    angle_deg: float
    outvoted: bool

    @property
    def text(self) -> str:
        """A conflict without a majority, for people."""
        return (
            f"{self.snapshot} and {', '.join(self.others)} place it {self.distance_m:.3f} m and "
            f"{self.angle_deg:.2f} deg apart relative to {self.lidars[1]}, without a majority of snapshots"
        )


@dataclass(frozen=True, slots=True, eq=False)
class ContestedPlace:
    """Two accepted pairs that put the LiDAR at different places."""

    pair: Annotated[tuple[str, str], Field(description="Target and source of the pair with more evidence.")]
    other: Annotated[tuple[str, str], Field(description="Target and source of the other pair.")]
    distance_m: Annotated[float, Field(description="Distance between the two places.")]
    angle_deg: Annotated[float, Field(description="Angle between the two orientations.")]
    # The pose of `pair` that follows from `other`, scored but not registered; None without verification.
    competing: Annotated[Registration | None, *not_in_document()] = None


@dataclass(frozen=True, slots=True, eq=False)
class LidarPlacement:
    """The pose of one LiDAR, or why it has none.

    Args:
        status: both `placed` and `uncertain` LiDARs have a pose.
        covariance: (6, 6) of the pose, order rotation (rad), translation (m), both along the target's axes.
        repeatability: (6, 6) the part of it that random errors cause: by so much do results differ in one place.
        T_target_source_prior: the pose that the prior claims; None where it lacks the LiDAR or the target.
        held_by_movable: only objects that can move hold the pose of an uncertain LiDAR in some direction.
        contradicts_prior: whether the beams of a LiDAR without a pose contradict the prior, so that it moved far.
    """

    lidar: str
    reason: str
    status: PlacementStatus = "not_placed"
    T_target_source: RigidTransform | None = None
    fitness: float = 0.0
    rmse_m: float = float("inf")
    covariance: FloatArray | None = None
    repeatability: FloatArray | None = None
    T_target_source_prior: RigidTransform | None = None
    sigma_from: SigmaOrigin = "residuals"
    spread: Spread | None = None
    contested: ContestedPlace | None = None
    held_by_movable: bool = False
    contradicts_prior: bool = False

    @property
    def placed(self) -> bool:
        """True if the LiDAR has a pose that can be used without further checks."""
        return self.status == "placed"

    @property
    def uncertain(self) -> bool:
        """True if the LiDAR has a pose whose standard deviation is above the limit."""
        return self.status == "uncertain"

    @property
    def prior_deviation(self) -> tuple[float, float] | None:
        """Distance in metres, angle in radians from the pose of the prior; None where one of the two is not known."""
        if self.T_target_source is None or self.T_target_source_prior is None:
            return None
        return self.T_target_source_prior.distance_to(self.T_target_source)

    @property
    def repeatability_xyz_m(self) -> FloatArray | None:
        """(3,) standard deviation of the position by random errors alone; None where it is not known."""
        return None if self.repeatability is None else np.sqrt(np.diag(self.repeatability)[3:])

    @property
    def repeatability_deg(self) -> FloatArray | None:
        """(3,) the same of the rotation."""
        return None if self.repeatability is None else np.rad2deg(np.sqrt(np.diag(self.repeatability)[:3]))

    @property
    def sigma_xyz_m(self) -> FloatArray | None:
        """(3,) standard deviation of the position along the target's axes; None where it is not known."""
        return None if self.covariance is None else np.sqrt(np.diag(self.covariance)[3:])

    @property
    def sigma_rotation_deg(self) -> FloatArray | None:
        """(3,) standard deviation of the rotation about the target's axes; None where it is not known."""
        return None if self.covariance is None else np.rad2deg(np.sqrt(np.diag(self.covariance)[:3]))


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """LiDARs whose poses relative to each other are known.

    Args:
        root: the member whose frame is the group's.
        poses: per member ``T_root_member``, the root with the identity.
    """

    root: str
    poses: Mapping[str, RigidTransform]

    @classmethod
    def of_one(cls, name: str) -> "Group":
        """Create the group of a single LiDAR."""
        return cls(name, {name: RigidTransform.identity(name, name)})

    @property
    def members(self) -> tuple[str, ...]:
        """Names in order."""
        return tuple(sorted(self.poses))

    def joined(self, other: "Group", T_root_other: RigidTransform) -> "Group":
        """Return this group with another one's members added."""
        added = {name: T_root_other @ pose for name, pose in other.poses.items()}
        return Group(self.root, {**self.poses, **added})

    def pose_of(self, other: "Group", known: RigidTransform) -> RigidTransform:
        """Return the pose of the other group's root in this one's, from a pose between two of their members."""
        if known.target in other.poses:
            known = known.inverse()
        return self.poses[known.target] @ known @ other.poses[known.source].inverse()


@dataclass(frozen=True, slots=True)
class MergeCandidate:
    """A pair that a merge step could have chosen."""

    target: Target
    source: Source
    fitness: Annotated[
        Figure, Field(description="Share of the source points that lie near a surface of the target cloud.")
    ]
    rmse_m: Annotated[Figure, Field(description="RMS distance of those points to their nearest target point.")]
    passes: Annotated[bool, Field(description="True if the pair may be merged.")]
    evidence: Annotated[Figure, Field(description="Evidence of the pair's registration.")] = 0.0
    reason: Annotated[str, Field(description="Reason why the pair does not pass; empty if it does.")] = ""
    uncertain: Annotated[bool, Field(description="True if the pair may be merged only where no other pair passes.")] = (
        False
    )
    of_groups: Annotated[
        bool, Field(description="True if the merged clouds of two groups were registered; the names are their roots.")
    ] = False

    @property
    def names(self) -> frozenset[str]:
        """Target and source, without order."""
        return frozenset((self.target, self.source))


@dataclass(frozen=True, slots=True)
class MergeDecision:
    """One merge step."""

    step: Annotated[int, Field(description="Number of the step, from 0.")]
    candidates: Annotated[
        tuple[MergeCandidate, ...], Field(description="Pairs that could have been chosen, the best first.")
    ]
    chosen: Annotated[
        MergeCandidate | None, Field(description="The pair that was merged; null if the merge stopped here.")
    ]
    reason: Annotated[str, Field(description="Reason for the decision, with its figures.")]
    groups: Annotated[
        tuple[tuple[str, ...], ...], Field(description="Connected LiDARs after the step, the largest group first.")
    ]


@dataclass(frozen=True, slots=True)
class PairResidual:
    """Disagreement of the poses with one registered pair, before and after the refinement."""

    target: Target
    source: Source
    before_m: Annotated[Figure, Field(description="Distance before.")]
    before_deg: Annotated[Figure, Field(description="Angle before.")]
    after_m: Annotated[Figure, Field(description="Distance after.")]
    after_deg: Annotated[Figure, Field(description="Angle after.")]
    weight: Annotated[float, Field(description="Final weight of the pair: 1 for full trust, 0 for an outlier.")]
    probability: Annotated[
        float,
        Field(
            description="Probability that a correct pair is as far or farther from where the others put it, by the "
            "covariances of both: chi squared with 6 degrees of freedom. 1 if no others connect its LiDARs."
        ),
    ] = 1.0
    apart_m: Annotated[Figure, Field(description="Distance of the pair from where the others put it.")] = 0.0
    apart_deg: Annotated[Figure, Field(description="Angle of the pair from where the others put it.")] = 0.0
    snapshot: Annotated[str, Field(description="Snapshot of the pair; empty for a single snapshot.")] = ""

    @property
    def contradicts(self) -> bool:
        """True if the pair disagrees with the others more than one correct pair of a thousand."""
        return self.probability < LEAST_PROBABILITY


@dataclass(frozen=True, slots=True)
class SensorBias:
    """Systematic errors of one LiDAR, as estimated with the poses; the points are not corrected by them.

    Only differences between LiDARs are seen in most scenes. A standard deviation close to that of the prior means that
    the scene does not show the bias.
    """

    lidar: Annotated[str, Field(description="Name of the LiDAR.")]
    range_m: Annotated[float, Field(description="Measured minus true range, the part that is the same near and far.")]
    range_sigma_m: Annotated[float, Field(description="Standard deviation of it.")]
    elevation_deg: Annotated[float, Field(description="Measured minus true elevation angle.")]
    elevation_sigma_deg: Annotated[float, Field(description="Standard deviation of it.")]
    range_scale_ppm: Annotated[float, Field(description="Scale of the ranges, less one, in millionths.")]
    range_scale_sigma_ppm: Annotated[float, Field(description="Standard deviation of it.")]
    glancing_m: Annotated[
        float,
        Field(description="Range on a surface that the beam grazes, less that on one that it meets head-on."),
    ]
    glancing_sigma_m: Annotated[float, Field(description="Standard deviation of it.")]


@dataclass(frozen=True, slots=True)
class CycleError:
    """Largest disagreement of the poses with a registered pair."""

    m: Annotated[Figure, Field(description="Distance.")]
    deg: Annotated[Figure, Field(description="Angle.")]


@dataclass(frozen=True, slots=True)
class Refinement:
    """The joint refinement over all accepted pairs."""

    cycle_error_before: Annotated[CycleError, Field(description="Largest disagreement before.")]
    cycle_error_after: Annotated[CycleError, Field(description="Largest disagreement after.")]
    pairs: Annotated[tuple[PairResidual, ...], Field(description="Disagreement per pair.")]
    biases: Annotated[tuple[SensorBias, ...], Field(description="Systematic errors per LiDAR, in name order.")] = ()

    @classmethod
    def of(cls, pairs: tuple[PairResidual, ...] = (), biases: tuple[SensorBias, ...] = ()) -> "Refinement":
        """Create from the residuals of the pairs; without loops there are none, and nothing to adjust."""
        figures = [(pair.before_m, pair.before_deg, pair.after_m, pair.after_deg) for pair in pairs]
        before_m, before_deg, after_m, after_deg = map(max, zip((0.0,) * 4, *figures, strict=True))
        return cls(CycleError(before_m, before_deg), CycleError(after_m, after_deg), pairs, biases)
