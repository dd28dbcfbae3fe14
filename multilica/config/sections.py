# SPDX-License-Identifier: Apache-2.0
"""The configuration and its sections, in the order of the stages."""

import math
from datetime import datetime
from typing import Annotated, Literal, get_args

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, Strict

from multilica.documents import require_length

Stage = Literal[
    "ingest", "preprocess", "features", "correspond", "coarse", "verify", "fine", "merge", "refine", "ground"
]
STAGES: tuple[Stage, ...] = get_args(Stage)

NotNegative = Annotated[float, Strict(), Field(ge=0.0)]
Positive = Annotated[float, Strict(), Field(gt=0.0)]
PositiveMetres = Annotated[float, Strict(), Field(gt=0.0), AfterValidator(require_length)]
Metres = Annotated[float, Strict(), Field(ge=0.0), AfterValidator(require_length)]
Share = Annotated[float, Strict(), Field(ge=0.0, le=1.0)]
Count = Annotated[int, Strict(), Field(ge=1)]


def _number_or_auto(stops: object) -> object:
    if stops == "auto" or (type(stops) is int and stops >= 1):
        return stops
    raise ValueError("expected auto, or a whole number from 1 on")


Stops = Annotated[int | Literal["auto"], BeforeValidator(_number_or_auto)]
TimeText = Annotated[str, BeforeValidator(lambda time: str(time) if isinstance(time, datetime | int | float) else time)]
"""A text, or a time or number of TOML."""


class Section(BaseModel):
    """A table of the configuration: frozen, without unknown keys or numbers that are not finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)


class IngestConfig(Section):
    """Which part of the recording is read."""

    frames: Count = Field(
        10, description="frames accumulated per LiDAR; a recorded snapshot uses all its frames unless this is given"
    )
    start_s: float = Field(0.0, ge=0.0, description="start of the window, in seconds after the first frame")
    start_at: TimeText = Field(
        "", description="start of the window as a time: ISO 8601 (UTC by default), or s or ns since the epoch"
    )
    window: Literal["start", "auto"] = Field(
        "start", description="auto: the longest standstill after start_s; start: the frames right after start_s"
    )
    window_s: float = Field(
        0.0, ge=0.0, description="time over which the frames are spread; 0: consecutive frames, auto: at most 30 s"
    )
    topics: dict[str, str] = Field(
        default_factory=dict, description="LiDAR name -> its topic, or a pattern or type that matches one topic"
    )
    only: tuple[str, ...] = Field(
        (), description="topics, patterns such as /lidar_*/points, or types to use; empty: all topics with point clouds"
    )
    strict: bool = Field(default=False, description="fail if any part of the recording is unreadable")
    max_memory_mb: Positive = Field(
        2000.0, description="memory that reading may take; a source that needs more is refused"
    )
    timeout_s: Positive = Field(30.0, description="seconds after which reading from a live source stops")

    @property
    def chooses_topics(self) -> bool:
        """True if topics are left out on purpose."""
        return bool(self.topics or self.only)


class StillnessConfig(Section):
    """Detection of moving objects and of a moving vehicle."""

    enabled: bool = Field(default=True, description="drop points that move; refuse the snapshot of a moving vehicle")
    moving_clearance_m: PositiveMetres = Field(
        0.2,
        description="a return has moved if beams of another frame pass this far behind it; ten times the range noise",
    )
    max_shift_m: PositiveMetres = Field(
        0.05, description="largest shift of a LiDAR between its first and last frame; twice the range noise"
    )
    max_rotation_deg: Positive = Field(0.3, description="as max_shift_m, for rotation: 5 cm at a distance of 10 m")


class PreprocessConfig(Section):
    """Range limits and thinning of the returns."""

    min_range_m: Metres = Field(1.0, description="nearer returns are dropped: the vehicle's own body")
    max_range_m: PositiveMetres = Field(100.0, description="farther returns are dropped: too sparse to help")
    voxel_size_m: Metres = Field(0.05, description="voxel grid on which the clouds are thinned; 0: no thinning")


class HealthConfig(Section):
    """Detection of dirty sensors."""

    max_blockage_ratio: Share = Field(
        0.1, description="share of the field of view that may end in scattered echoes below preprocess.min_range_m"
    )


class FeaturesConfig(Section):
    """FPFH descriptors."""

    engine: Literal["numpy", "open3d"] = Field(
        "numpy",
        description="implementation of FPFH; open3d: slower, and its voxel grid begins at the cloud, not at the sensor",
    )
    voxel_size_m: PositiveMetres = Field(0.35, description="voxel grid on which descriptors are computed")
    retry_voxel_sizes_m: tuple[PositiveMetres, ...] = Field(
        (0.5, 0.25),
        description="voxel grids of further searches between LiDARs that no accepted pair connects, one after another",
    )
    normal_radius_voxels: Positive = Field(2.0, le=10.0, description="neighbourhood of a normal, in voxels")
    normal_neighbours: Count = Field(30, description="largest number of neighbours of a normal")
    feature_radius_voxels: Positive = Field(5.0, le=10.0, description="neighbourhood of a descriptor, in voxels")
    feature_neighbours: Count = Field(100, description="largest number of neighbours of a descriptor")
    max_range_m: PositiveMetres = Field(40.0, description="farther returns get no descriptor")
    range_shape: Literal["sphere", "box"] = Field(
        "sphere", description="shape of the crop at max_range_m; box: limits each coordinate in the LiDAR's frame"
    )
    orient_normals: bool = Field(default=True, description="orient normals towards the sensor that saw the surface")


class CorrespondConfig(Section):
    """Matching of descriptors."""

    mutual: bool = Field(default=True, description="keep a match only if each is the other's nearest neighbour")
    engine: Literal["brute_force", "kd_tree"] = Field(
        "brute_force",
        description="nearest-neighbour search; brute_force: in single precision; kd_tree: in double precision",
    )
    max_keypoints: int = Field(
        8000, ge=0, description="descriptors per LiDAR that are matched; more are drawn evenly; 0: all"
    )
    max_matches: int = Field(
        2000,
        ge=0,
        description="nearest matches for the coarse stage, which limit its memory; 0: all, in the order of the "
        "source's points",
    )


class CoarseConfig(Section):
    """Hypotheses from matches."""

    solver: Literal["cliques", "maximum_clique", "teaserpp", "kiss_matcher"] = Field(
        "cliques",
        description="cliques: several hypotheses, by the idea of TEASER++; maximum_clique: TEASER++ itself; teaserpp: "
        "the same by teaserpp_python if it is installed",
    )
    noise_bound_m: PositiveMetres = Field(0.35, description="largest error of a correct match; about one voxel")
    max_hypotheses: Count = Field(24, description="largest number of distinct hypotheses per pair")
    normal_tolerance_deg: float = Field(
        25.0,
        gt=0.0,
        le=180.0,
        description="largest difference between angles of normals within a clique; 180: normals are ignored",
    )
    min_agreeing_matches: int = Field(3, ge=0, description="a hypothesis with fewer agreeing matches is dropped")


class VerifyConfig(Section):
    """Ranking of the hypotheses by what the beams prove."""

    enabled: bool = Field(
        default=True, description="off: the hypothesis with the most matches is taken, as in the paper"
    )


class FineConfig(Section):
    """GICP of the finalists, and of the best of them on all points."""

    engine: Literal["small_gicp", "open3d"] = Field(
        "small_gicp",
        description="implementation of GICP; open3d: covariances follow from normals, and the voxel grid begins at the "
        "cloud, not at the sensor",
    )
    voxel_size_m: PositiveMetres = Field(
        0.15, description="voxel grid of GICP; on a finer grid, range noise tilts the normals and rotates the pose"
    )
    max_points: Count = Field(50_000, description="a cloud with more points is thinned on a coarser grid")
    max_correspondence_distances_m: tuple[PositiveMetres, ...] = Field(
        (0.5, 0.25), min_length=1, description="one GICP run each, from coarse to fine"
    )
    max_iterations: Count = Field(30, description="largest number of iterations of each run")
    rotation_epsilon_rad: Positive = Field(1e-4, description="converged when a step turns by less (small_gicp)")
    translation_epsilon_m: PositiveMetres = Field(1e-4, description="converged when a step moves by less (small_gicp)")
    neighbours: Annotated[int, Strict(), Field(ge=3)] = Field(
        20, description="points from which a covariance or a normal is estimated"
    )
    fitness_distance_m: PositiveMetres = Field(
        0.25, description="a point nearer than this to the other cloud is an inlier of fitness and RMSE"
    )
    max_finalists: Count = Field(
        6, description="distinct hypotheses per pair that are registered finely; the true one was always among four"
    )


class AcceptanceConfig(Section):
    """Limits that a registration has to keep, alone and against competing poses."""

    min_evidence: float = Field(
        2.3, description="log-odds that a pose needs to count as the true one: 10 to 1; see docs/concepts.md"
    )
    min_log_odds_margin: Positive = Field(
        4.6, description="log-odds that it needs against every other pose, and against the rig as a whole: 100 to 1"
    )
    max_sigma_m: PositiveMetres = Field(
        0.02, description="largest standard deviation of a position; a pose above it is uncertain"
    )
    max_sigma_deg: Positive = Field(0.2, description="as max_sigma_m, for rotation: 3.5 cm at a distance of 10 m")
    max_baseline_m: PositiveMetres = Field(
        15.0, description="largest distance between two LiDARs of one vehicle; every stage drops poses beyond it"
    )
    perturbation_m: PositiveMetres = Field(
        0.3, description="perturbation along the weakest direction; rotations count as arcs at 10 m"
    )
    max_perturbed_offset_m: PositiveMetres = Field(
        0.15,
        description="a pose slides if a perturbed or thinned registration ends farther away; half of perturbation_m",
    )
    min_well_constrained_eigenvalue: NotNegative = Field(
        8.0,
        description="a pose is well constrained if the smallest eigenvalue of its information (points, 10 m arm) "
        "reaches this; for others more poses are tested",
    )


class MergeConfig(Section):
    """Growth of the calibrated cloud."""

    mode: Literal["graph", "algorithm1", "target_first"] = Field(
        "graph",
        description="graph: accepted pairs join their LiDARs, groups are registered only if no such pair joins them; "
        "algorithm1: the best pair first, then the pairs of its LiDARs again, as in the paper; target_first: "
        "each LiDAR to the target, then the others to the merged cloud, as in the published code of the paper",
    )
    fitness_threshold: Share = Field(0.2, description="without verification, a pair needs a larger fitness")


class RefineConfig(Section):
    """Joint adjustment of all poses to all accepted pairs, with covariances."""

    enabled: bool = Field(default=True, description="off: poses stay as merged")
    outlier_sigma: Positive = Field(3.0, description="a pair off by this many sigma keeps half its weight")
    range_bias_sigma_m: PositiveMetres = Field(
        0.01, description="range accuracy of the LiDARs, one standard deviation; datasheets state two or three of them"
    )
    range_bias_sigmas_m: dict[str, PositiveMetres] = Field(
        default_factory=dict, description="the same of single LiDARs, by name"
    )
    elevation_bias_sigma_deg: Positive = Field(
        0.005, description="error of a LiDAR's elevation angles that they have in common, one standard deviation"
    )
    range_scale_sigma: Positive = Field(2e-4, description="the same of the scale of its ranges, relative")
    glancing_bias_sigma_m: PositiveMetres = Field(
        0.005, description="error of ranges on surfaces that beams graze, against those head-on, one standard deviation"
    )

    def bias_sigmas(self, lidar: str) -> tuple[float, float, float, float]:
        """Return those of a LiDAR's biases: in range (m), elevation (rad), scale, and range on grazed surfaces (m)."""
        range_m = self.range_bias_sigmas_m.get(lidar, self.range_bias_sigma_m)
        elevation_rad = math.radians(self.elevation_bias_sigma_deg)
        return range_m, elevation_rad, self.range_scale_sigma, self.glancing_bias_sigma_m


class JointConfig(Section):
    """Several snapshots of one rig as one result."""

    max_disagreement_m: PositiveMetres = Field(
        0.05,
        description="snapshots contradict each other if they place a LiDAR farther apart, and by refine.outlier_sigma; "
        "correct poses differ by millimetres",
    )
    max_disagreement_deg: Positive = Field(0.5, description="as max_disagreement_m, for rotation: 9 cm at 10 m")


class DriveConfig(Section):
    """Stops of one drive, which what the LiDARs see at several of them links."""

    stops: Stops = Field(
        "auto",
        description="standstills of a log that are used; auto: up to four that differ in place and see much, "
        "or the frames that ingest chooses if it sets start_s, start_at, window or window_s",
    )
    max_distance_m: Metres = Field(
        40.0, description="largest distance between LiDARs at two stops that are linked; 0: no links are sought"
    )


class GroundConfig(Section):
    """The plane under the vehicle."""

    enabled: bool = Field(default=False, description="estimate roll, pitch and z of the base frame")
    frame: str = Field("base", min_length=1, description="name of the base frame")
    max_range_m: PositiveMetres = Field(20.0, description="only points nearer than this to the rig's middle are used")
    max_tilt_deg: float = Field(
        60.0, gt=0.0, le=90.0, description="largest tilt of the ground against the target's z axis"
    )


class RuntimeConfig(Section):
    """Worker processes and random numbers."""

    workers: int = Field(
        0,
        ge=0,
        description="worker processes; 0: one per core that this process may use; 1: none, this process does all work; "
        "any number gives the same result",
    )
    max_time_s: NotNegative = Field(
        0.0,
        description="searches end this long after the start; 0: no limit; with one, equal runs may differ",
    )
    seed: int = Field(0, ge=0, description="seed of everything random")


class RecordConfig(Section):
    """Size of recording.rrd."""

    detail: Literal["full", "normal", "slim"] = Field(
        "normal",
        description="full: every point and match; normal: clouds up to half a million points, a sample of the "
        "matches; slim: no raw clouds and descriptors, small samples of the rest",
    )
    max_megabytes: Positive = Field(
        100.0, description="a larger recording is thinned to this size, and its log says so; full: no limit"
    )


class CalibrationConfig(Section):
    """The whole configuration; one table per section."""

    preset: Literal["default", "paper", "paper-algorithm1"] = Field(
        "default", description="preset that the configuration started from"
    )
    target: str = Field("", description="name of the target LiDAR; empty: the one with the most overlap")
    until: Stage = Field("ground", description="the last stage to run")
    ingest: IngestConfig = IngestConfig()
    stillness: StillnessConfig = StillnessConfig()
    preprocess: PreprocessConfig = PreprocessConfig()
    health: HealthConfig = HealthConfig()
    features: FeaturesConfig = FeaturesConfig()
    correspond: CorrespondConfig = CorrespondConfig()
    coarse: CoarseConfig = CoarseConfig()
    verify: VerifyConfig = VerifyConfig()
    fine: FineConfig = FineConfig()
    acceptance: AcceptanceConfig = AcceptanceConfig()
    merge: MergeConfig = MergeConfig()
    refine: RefineConfig = RefineConfig()
    joint: JointConfig = JointConfig()
    drive: DriveConfig = DriveConfig()
    ground: GroundConfig = GroundConfig()
    runtime: RuntimeConfig = RuntimeConfig()
    record: RecordConfig = RecordConfig()
