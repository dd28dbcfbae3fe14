# SPDX-License-Identifier: Apache-2.0
"""The document that `result.json` holds."""

import math
from collections.abc import Mapping
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, ValidationError, WithJsonSchema, model_validator

from multilica.config import CalibrationConfig, Stage
from multilica.documents import DocumentError, first_problem, parse_json, shown
from multilica.errors import UnreadableSourceError
from multilica.geometry import FloatArray, RigidTransform, largest_index, read_only
from multilica.results.calibration import Refusal, SnapshotReport, TimeLimit
from multilica.results.clouds import SensorHealth
from multilica.results.placements import (
    ContestedPlace,
    LidarPlacement,
    MergeDecision,
    PlacementStatus,
    Refinement,
    SigmaOrigin,
    Spread,
)
from multilica.results.registrations import Stability, Verdict
from multilica.results.stages import StageFigures
from multilica.results.stops import Knock, StopLink, StopMotion
from multilica.results.values import Entry, Matrix4, Matrix6, Number, PairNames, PoseEntry, Quaternion, Vector3

RESULT_SCHEMA: Literal["multilica/result/1"] = "multilica/result/1"


class InputLidarEntry(Entry):
    """A LiDAR of the input."""

    topic: str = Field(description="Topic in the recording; empty if there is none.")
    frame_id: str = Field(description="Frame of its messages; empty if there is none.")
    frames: int = Field(description="Number of frames.")
    points: int = Field(description="Number of points.")


class InputEntry(Entry):
    """The snapshot that was calibrated."""

    source: str = Field(description="Name of the file, or address; empty for data in memory.")
    sha256: str = Field(description="Hash of the file, or of the hashes of several; empty if it is not known.")
    lidars: Mapping[str, InputLidarEntry] = Field(description="Per LiDAR.")
    notes: tuple[str, ...] = Field((), description="Warnings of the reader, such as lost scans or implausible points.")


class ProgressEntry(Entry):
    """Progress of the run."""

    finished: tuple[Stage, ...] = Field(description="Finished stages, in order.")
    running: Stage | None = Field(description="The stage that was running when the document was written.")


class GroundEntry(Entry):
    """The ground plane, seen from the target LiDAR."""

    frame: str = Field(description="Name of the base frame, on the ground: x forward, y left, z up (ISO 8855).")
    normal: Vector3 = Field(description="Unit normal in the target frame, upwards.")
    offset_m: float = Field(description="Height of the target LiDAR above the ground.")
    T_base_target: Matrix4 = Field(
        description="The target in the base frame; x, y, yaw are those of the rig file, or 0 without one."
    )
    xyz_m: Vector3 = Field(description="Position of that pose.")
    rpy_deg: Vector3 = Field(description="Roll, pitch, yaw of that pose.")
    inlier_share: Number = Field(description="Share of ground in the area that is seen near the vehicle.")
    area_m2: Number = Field(description="Area of the ground that is seen.")
    residual_m: Number = Field(description="RMS distance of its points from a smooth surface.")
    sigma_z_m: Number = Field(description="Standard deviation of the height.")
    sigma_roll_pitch_deg: tuple[float, float] = Field(
        description="Standard deviations of the rotation about x and y of the base frame."
    )
    doubt: str = Field(description="Reason why the plane is uncertain; empty if it is not.")
    T_base_target_rig: Matrix4 | None = Field(description="The target in the base frame by the rig file; null without.")
    text: str = Field(description="The same for people.")


class PriorEntry(PoseEntry):
    """The pose that the prior gives, in the target frame."""

    deviation_m: Number = Field(description="Distance of the result from the prior; null without a pose.")
    deviation_deg: Number = Field(description="Angle of the result from the prior; null without a pose.")
    surprise: str | None = Field(description="Warning about a result that is far from the prior; null if it is near.")


class LidarEntry(Entry):
    """One LiDAR of the rig."""

    placed: bool = Field(description="True if the LiDAR has a pose that can be used without further checks.")
    status: PlacementStatus = Field(
        description="`uncertain`: one pose fits, uncontradicted, but its standard deviation is above the limit."
    )
    T_target_source: Matrix4 | None = Field(
        description="Rows of the matrix: p_target = T_target_source @ p_source; null if not placed nor uncertain."
    )
    xyz_m: Vector3 | None = Field(description="Position in the target frame.")
    rpy_deg: Vector3 | None = Field(description="Roll, pitch, yaw, extrinsic xyz, about the fixed axes of the target.")
    quaternion_xyzw: Quaternion | None = Field(description="Rotation as a unit quaternion, w last.")
    fitness: Number = Field(description="Share of the points that lie near a surface of the target cloud.")
    rmse_m: Number = Field(description="RMS distance of those points to their nearest target point.")
    sigma_xyz_m: Vector3 | None = Field(
        description="Standard deviation along the axes of the target. Tables show that of the weakest direction."
    )
    sigma_rotation_deg: Vector3 | None = Field(description="Standard deviation about the axes of the target.")
    repeatability_xyz_m: Vector3 | None = Field(
        None,
        description="Part of the standard deviation that random errors cause: how far results in one place differ.",
    )
    repeatability_deg: Vector3 | None = Field(None, description="The same of the rotation.")
    sigma_from: SigmaOrigin = Field(
        description="Source of the covariance: residuals by surface and ring with the biases of the LiDARs, or its "
        "widening to the spread over snapshots."
    )
    covariance: Matrix6 | None = Field(description="Order: rotation (rad), translation (m), along the target's axes.")
    prior: PriorEntry | None = Field(description="The pose that the prior gives; null without a prior.")
    spread: Spread | None = Field(description="Scatter over snapshots; null for a single snapshot.")
    contested: ContestedPlace | None = Field(description="Accepted pairs that contradict each other on it, or null.")
    reason: str = Field(
        description="The pair or step that placed the LiDAR, or the reason why it is uncertain or not placed."
    )
    health: SensorHealth | None = Field(description="Findings about the sensor; null if it was not examined.")
    held_by_movable: bool = Field(
        default=False,
        description="True if only objects of the size of vehicles and people hold an `uncertain` pose in some "
        "direction: they moved, or one frame cannot tell whether they did.",
    )

    @property
    def largest_sigmas(self) -> tuple[float, float] | None:
        """The standard deviations of position (m) and rotation (deg) in their weakest directions, as limits test them.

        None without a covariance.
        """
        if self.covariance is None:
            return None
        (sigma_m, _), (sigma_deg, _) = self.weakest_directions()
        return sigma_m, sigma_deg

    def weakest_directions(self) -> tuple[tuple[float, str], tuple[float, str]]:
        """Return the largest standard deviations of position (m) and rotation (deg), each with its main axis.

        Raises:
            ValueError: the LiDAR has no covariance.
        """
        if self.covariance is None:
            raise ValueError("there is no covariance")
        covariance = np.asarray(self.covariance)
        sigma_rad, about = _weakest_direction(covariance[:3, :3])
        return _weakest_direction(covariance[3:, 3:]), (math.degrees(sigma_rad), about)


class StopEntry(Entry):
    """The vehicle at one stop of a drive."""

    name: str = Field(description="Name of the stop.")
    first: str = Field(description="The first of the stops that links connect with this one.")
    T_first_stop: Matrix4 = Field(
        description="The target LiDAR at this stop in its own frame at the first stop: p_first = T_first_stop @ p_stop."
    )
    xyz_m: Vector3 = Field(description="Position of that pose.")
    rpy_deg: Vector3 = Field(description="Roll, pitch, yaw of that pose.")
    covariance: Matrix6 | None = Field(
        description="Order: rotation (rad), translation (m), along the axes of the first stop; null at that stop."
    )


class RegistrationEntry(Entry):
    """One hypothesis after GICP, with its visibility score."""

    hypothesis: int = Field(description="Index of its hypothesis; -1 if the pose came from other pairs.")
    origin: str = Field(description="Solver of that hypothesis, or `prior`; empty if the pose came from other pairs.")
    derivation: str = Field(
        "", description="Relation of the pose to its hypothesis, or the LiDARs that imply it; else empty."
    )
    T_target_source: Matrix4 = Field(description="Rows of the homogeneous matrix, lengths.")
    agree: int = Field(description="Points on a surface that the other LiDAR measured.")
    violate: int = Field(description="Points in space that beams of the other LiDAR passed through.")
    occluded: int = Field(description="Points behind a measured surface.")
    unseen: int = Field(description="Points outside the field of view of the other LiDAR.")
    evidence: Number = Field(description="Log-odds that the pose is the true one; the rank.")
    fitness: Number = Field(description="Share of the points that lie near a surface of the target cloud.")
    rmse_m: Number = Field(description="RMS distance of those points to their nearest target point.")
    weakest_curvature: Number = Field(
        description="Smallest eigenvalue of the GICP Hessian per inlier; rotation at 10 m."
    )
    min_information_eigenvalue: Number = Field(description="Number of points that constrain the weakest direction.")
    stability: Stability | None = Field(description="Result of the stability test; null if it was not run.")


class PairEntry(PoseEntry, PairNames):
    """A registered pair of LiDARs."""

    fitness: Number = Field(description="Share of the source points that lie near a surface of the target cloud.")
    rmse_m: Number = Field(description="RMS distance of those points to their nearest target point.")
    inliers: int = Field(description="Number of those points.")
    converged: bool | None = Field(description="True if GICP converged; null if the engine does not report it.")
    iterations: int | None = Field(description="Number of GICP iterations; null where the engine does not report it.")
    engine: str = Field(description="GICP implementation.")
    hypothesis: int = Field(description="Index of its hypothesis; -1 if the pose came from other pairs.")
    hessian: Matrix6 | None = Field(description="GICP Hessian, order rotation, translation, about the source frame.")
    verdict: Verdict = Field(description="The decision on this pair.")
    registrations: tuple[RegistrationEntry, ...] = Field(description="Chosen first; empty without verification.")

    @property
    def pose(self) -> RigidTransform:
        """``T_target_source`` of the pair."""
        return RigidTransform(self.target, self.source, np.asarray(self.T_target_source))

    @property
    def evidence(self) -> float:
        """Evidence of the chosen registration; the fitness without verification."""
        return (self.registrations[0].evidence if self.registrations else self.fitness) or 0.0


class ResultDocument(Entry):
    """The outcome of a calibration run.

    Units are in the names of the keys: `_m` metres, `_deg` degrees, `_rad` radians, `_s` seconds. Matrices have metres.
    Null stands for what is not known.
    """

    schema_: Literal["multilica/result/1"] = Field(alias="schema", description="Name and version of this format.")
    status: Literal["complete", "partial", "failed", "unfinished"] = Field(
        description="`complete`: all placed; `failed`: none but the target has a pose; `unfinished`: it was cut off."
    )
    target: str = Field(description="LiDAR that all poses are relative to; empty until it is chosen.")
    target_reason: str = Field(description="Reason for the choice of the target.")
    accepted_by: Literal["evidence", "fitness"] = Field(
        "evidence",
        description="Placements were accepted by evidence of the beams, or by fitness alone, as in the paper.",
    )
    refusal: Refusal | None = Field(description="Reason why the snapshot was not calibrated; null if it was.")
    lidars: Mapping[str, LidarEntry] = Field(description="Per LiDAR in name order, the target with the identity.")
    pairs: tuple[PairEntry, ...] = Field(description="All registered pairs, in name order.")
    decisions: tuple[MergeDecision, ...] = Field(description="Merge steps, in order.")
    snapshots: tuple[SnapshotReport, ...] = Field(description="Snapshots of a joint result, else empty.")
    stops: tuple[StopEntry, ...] = Field((), description="Stops of a drive that links connect, else empty.")
    links: tuple[StopLink, ...] = Field((), description="Registrations between stops, also those that are not used.")
    knocks: tuple[Knock, ...] = Field((), description="LiDARs that moved on the vehicle between two stops of a drive.")
    motions: tuple[StopMotion, ...] = Field((), description="Motions of LiDARs between two stops, by odometry.")
    refinement: Refinement | None = Field(description="The joint refinement; null if it did not run.")
    ground: GroundEntry | None = Field(description="The ground plane; null if none was asked for or found.")
    ground_refusal: str = Field("", description="Reason why a requested ground plane is missing; else empty.")
    time_limit: TimeLimit | None = Field(None, description="Set if the time limit ended the search.")
    timing_s: Mapping[str, Number] = Field(description="Wall time per stage, in seconds.")
    input: InputEntry = Field(description="The snapshot that was calibrated.")
    config: Annotated[CalibrationConfig, WithJsonSchema({"type": "object"})] = Field(
        description="The resolved configuration, see docs/reference/configuration.md."
    )
    versions: Mapping[str, str] = Field(description="Version per package.")
    platform: str = Field(description="Operating system and processor.")
    progress: ProgressEntry | None = Field(None, description="Progress of the run; null if it is not known.")
    stages: StageFigures | None = Field(None, description="Figures per finished stage; null if they are not known.")

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        unknown = sorted({name for pair in self.pairs for name in pair.names} - {*self.lidars})
        if unknown:
            raise ValueError(f"`pairs` names {unknown[0]}, which `lidars` lacks")
        contested = [entry.contested for entry in self.lidars.values() if entry.contested is not None]
        if {key for each in contested for key in (each.pair, each.other)} - {pair.key for pair in self.pairs}:
            raise ValueError("`contested` of a LiDAR names a pair that `pairs` lacks")
        for entry in self.lidars.values():
            if entry.placed != (entry.status == "placed"):
                raise ValueError("`lidars` has a LiDAR whose `placed` contradicts its `status`")
            if entry.status != "not_placed" and entry.T_target_source is None:
                raise ValueError(f"`lidars` has a LiDAR that is {entry.status} without a pose")
            if entry.status == "uncertain" and entry.covariance is None:
                raise ValueError("`lidars` has an uncertain LiDAR without a covariance")
        if self.poses and self.target not in self.lidars:
            raise ValueError(f"`lidars` lacks the target {self.target!r}")
        return self

    @property
    def placed(self) -> frozenset[str]:
        """Names of the placed LiDARs, the target among them."""
        return frozenset(name for name, entry in self.lidars.items() if entry.placed)

    @property
    def poses(self) -> dict[str, RigidTransform]:
        """``T_target_source`` of each placed or uncertain LiDAR, the target among them."""
        return {name: pose for name in self.lidars if (pose := self.pose(name)) is not None}

    def pose(self, lidar: str) -> RigidTransform | None:
        """Return ``T_target_source`` of a LiDAR; None if it is neither placed nor uncertain."""
        entry = self.lidars[lidar]
        if entry.status == "not_placed" or entry.T_target_source is None:
            return None
        return RigidTransform(self.target, lidar, np.asarray(entry.T_target_source))

    @property
    def covariances(self) -> dict[str, FloatArray]:
        """The covariances (6, 6) of the poses in the target's frame that have one; the target has none."""
        known = {name: entry.covariance for name, entry in self.lidars.items() if name != self.target}
        return {name: read_only(value, np.float64) for name, value in known.items() if value is not None}

    @property
    def placements(self) -> tuple[LidarPlacement, ...]:
        """The LiDARs as values, in name order."""
        return tuple(
            LidarPlacement(
                name,
                entry.reason,
                entry.status,
                self.pose(name),
                math.nan if entry.fitness is None else entry.fitness,
                math.inf if entry.rmse_m is None else entry.rmse_m,
                None if entry.covariance is None else read_only(entry.covariance, np.float64),
            )
            for name, entry in sorted(self.lidars.items())
        )


def _weakest_direction(covariance: FloatArray) -> tuple[float, str]:
    variances, directions = np.linalg.eigh(covariance)
    return math.sqrt(max(float(variances[-1]), 0.0)), "xyz"[largest_index(directions[:, -1])]


def parse_result(source: object, text: str | bytes) -> ResultDocument:
    """Read a result document from its JSON text.

    Args:
        source: the file, for the error message.

    Raises:
        UnreadableSourceError: not JSON, of another schema, or damaged.
    """
    try:
        return ResultDocument.model_validate(parse_json(text))
    except DocumentError as error:
        raise UnreadableSourceError(f"{source} is not a JSON file that can be read: {error}.") from error
    except ValidationError as error:
        raise UnreadableSourceError(_problem(source, error)) from error


def _problem(source: object, error: ValidationError) -> str:
    problems = error.errors(include_url=False, include_context=False)
    schema = next(
        (each for each in problems if each["loc"] in ((), ("schema",)) and each["type"] != "value_error"), None
    )
    if schema is not None:
        found = shown(schema["input"]) if schema["type"] == "literal_error" else None
        return f"{source} has schema {found}; expected '{RESULT_SCHEMA}', as the result.json of a run has it."
    where, what, _ = first_problem(error)
    where = where or "the document"
    return f"{source} is not a whole result: {where}: {what}. Calibrate again with this version of multilica."
