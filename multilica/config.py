# SPDX-License-Identifier: Apache-2.0
"""Every parameter of multilica, each once, with its unit, default and meaning."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from multilica.errors import ConfigError, UnknownNameError

__all__ = [
    "PRESETS",
    "STAGES",
    "CalibrationConfig",
    "CoarseConfig",
    "CorrespondConfig",
    "FeaturesConfig",
    "FineConfig",
    "GroundConfig",
    "HealthConfig",
    "IngestConfig",
    "JointConfig",
    "MergeConfig",
    "PreprocessConfig",
    "RecordConfig",
    "RefineConfig",
    "RuntimeConfig",
    "Stage",
    "StillnessConfig",
    "VerifyConfig",
    "load_config",
    "preset",
    "with_overrides",
]

Stage = Literal[
    "ingest", "preprocess", "features", "correspond", "coarse", "verify", "fine", "merge", "refine", "ground"
]
STAGES: tuple[Stage, ...] = get_args(Stage)

PositiveMetres = Annotated[float, Field(gt=0.0)]
Metres = Annotated[float, Field(ge=0.0)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Count = Annotated[int, Field(ge=1)]


class Section(BaseModel):
    """A table of the configuration: frozen, and closed to unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class IngestConfig(Section):
    """What is taken from the recording."""

    frames: Count = Field(
        10, description="frames per LiDAR that are accumulated; of a recorded snapshot all, unless this is given"
    )
    start_s: float = Field(0.0, ge=0.0, description="seconds after the first frame at which the window begins")
    start_at: str = Field(
        "",
        description="as start_s, but a time: ISO 8601 (UTC unless it says otherwise), or s or ns since the epoch",
    )
    window: Literal["start", "auto"] = Field(
        "start", description="auto: from start_s on, the longest stretch in which the vehicle stands still"
    )
    window_s: float = Field(
        0.0, ge=0.0, description="time over which the frames are spread; 0: one after the other, auto: at most 30"
    )
    topics: dict[str, str] = Field(
        default_factory=dict, description="LiDAR name -> its topic, or a pattern or type that only one topic has"
    )
    only: tuple[str, ...] = Field(
        (), description="topics, patterns as /lidar_*/points, or types; empty: topics, else all with point clouds"
    )
    strict: bool = Field(default=False, description="refuse a recording of which less than all can be used")
    timeout_s: float = Field(30.0, gt=0.0, description="seconds after which a live source is listened to no longer")

    @field_validator("start_at", mode="before")
    @classmethod
    def _as_text(cls, value: object) -> object:
        """TOML has times and numbers of its own."""
        return str(value) if isinstance(value, datetime | int | float) else value


class StillnessConfig(Section):
    """What must not move while the snapshot is taken."""

    enabled: bool = Field(
        default=True, description="drop what moves between frames; refuse a snapshot of a moving vehicle"
    )
    beyond_m: PositiveMetres = Field(
        0.2,
        description="a return has moved if another frame's beams pass this far behind it; ten times the range noise",
    )
    max_shift_m: PositiveMetres = Field(
        0.05, description="a LiDAR that goes farther between its first and last frame moves; twice the range noise"
    )
    max_turn_deg: float = Field(0.3, gt=0.0, description="as max_shift_m, for turning: 5 cm at a distance of 10 m")


class PreprocessConfig(Section):
    """Which returns are kept."""

    min_range_m: Metres = Field(1.0, description="nearer returns are dropped: the vehicle's own body")
    max_range_m: PositiveMetres = Field(100.0, description="farther returns are dropped: too sparse to help")
    voxel_size_m: Metres = Field(0.05, description="grid on which the clouds are thinned; 0: not at all")


class HealthConfig(Section):
    """When a sensor is called dirty."""

    max_soiled_share: Share = Field(
        0.1, description="share of the field of view that may end in scattered echoes below preprocess.min_range_m"
    )


class FeaturesConfig(Section):
    """FPFH descriptors."""

    voxel_size_m: PositiveMetres = Field(0.35, description="grid on which descriptors are computed")
    further_voxel_sizes_m: tuple[PositiveMetres, ...] = Field(
        (0.5, 0.25),
        description="grids on which LiDARs that no accepted pair links are searched again, one after another",
    )
    normal_radius_voxels: PositiveMetres = Field(2.0, description="neighbourhood of a normal, in voxels")
    feature_radius_voxels: PositiveMetres = Field(5.0, description="neighbourhood of a descriptor, in voxels")
    max_range_m: PositiveMetres = Field(40.0, description="returns beyond are left out of the coarse stage")
    orient_normals: bool = Field(default=True, description="turn normals towards the sensor that saw the surface")


class CorrespondConfig(Section):
    """Which descriptors are paired."""

    mutual: bool = Field(default=True, description="keep a pair only if each is the other's nearest")
    max_keypoints: Count = Field(
        8000, description="descriptors per LiDAR that are matched; drawn evenly if there are more"
    )
    max_matches: Count = Field(2000, description="the best so many matches go to the coarse stage; bounds its memory")


class CoarseConfig(Section):
    """The pose without an initial guess."""

    solver: Literal["cliques", "kiss_matcher", "teaserpp", "ransac", "fgr"] = Field(
        "cliques", description="cliques: the built-in solver after TEASER++"
    )
    noise_bound_m: PositiveMetres = Field(0.35, description="largest error of a correct match; about one voxel")
    max_hypotheses: Count = Field(24, description="distinct poses that are handed on")
    normal_tolerance_deg: float = Field(
        25.0,
        gt=0.0,
        le=180.0,
        description="by how much angles between normals may differ within a clique; 180: ignored",
    )
    max_baseline_m: PositiveMetres = Field(15.0, description="LiDARs of one vehicle are not farther apart than this")


class VerifyConfig(Section):
    """Judging hypotheses by what the beams prove empty."""

    enabled: bool = Field(
        default=True, description="off: the hypothesis with the most matches is taken, as the paper does"
    )
    max_range_m: PositiveMetres = Field(50.0, description="points beyond are left out")
    voxel_size_m: PositiveMetres = Field(0.5, description="grid of the short GICP that each hypothesis gets")
    max_points: Count = Field(4000, description="points per LiDAR of the short GICP; a denser cloud is thinned further")
    max_iterations: Count = Field(
        10, description="iterations of each run of the short GICP, and of a finalist that then has no hope of winning"
    )
    probe_voxel_size_m: PositiveMetres = Field(0.5, description="grid of the points that are judged")
    tolerance_m: PositiveMetres = Field(0.15, description="a point nearer than this to a measured surface lies on it")
    tolerance_deg: float = Field(0.5, gt=0.0, description="growth of that tolerance with range: the rotation's error")
    settled_after: Count = Field(
        6, ge=2, description="distinct answers that are tried before the search may stop early"
    )
    settled_after_firm: Count = Field(2, ge=2, description="the same where the best of them is firmly held")
    settled_ratio: Share = Field(0.5, description="it stops if the runner-up has at most this share of the evidence")
    rivals: int = Field(6, ge=0, description="poses turned by right angles that are tried against the best")
    rival_reach_m: PositiveMetres = Field(15.0, description="no farther apart are two LiDARs of one vehicle")
    loose_reach_m: PositiveMetres = Field(
        5.0,
        description="the same for a pose that is not firmly held: a chance agreement may be anywhere, a car is short",
    )
    slide_step_m: PositiveMetres = Field(
        1.0,
        description="steps along its weakest direction at which a pose is tried if it is not firmly held or slides",
    )
    slides: int = Field(6, ge=0, description="number of such steps to either side: repeating facades look alike there")
    finalists: Count = Field(16, description="distinct answers that are registered more finely")
    hopeless_evidence: PositiveMetres = Field(
        300.0,
        description="one that is so much behind the best and has less than max_equal of its evidence is hopeless",
    )
    finalist_points: Count = Field(10_000, description="points per LiDAR of that registration")
    final_tolerance_m: PositiveMetres = Field(0.08, description="as tolerance_m, for the finely registered")
    final_tolerance_deg: float = Field(0.2, gt=0.0, description="as tolerance_deg, for the finely registered")
    min_agree: Count = Field(100, description="points on common surfaces that a pose needs")
    max_violation_share: Share = Field(
        0.002, description="share of points in proven-empty space that can be chance: foliage, glass, what moved"
    )
    max_violation_share_firm: Share = Field(0.004, description="the same where the pose is firmly held")
    max_runner_up: Share = Field(0.7, description="share of the evidence that another distinct pose may have")
    max_equal: Share = Field(
        0.25, description="the same of a pose that would be accepted by itself: it may have less of the scene in view"
    )
    alike: Share = Field(0.8, description="such a pose explains at least this share of what the best explains")
    min_evidence: Metres = Field(
        30.0, description="distinctive agreement that explains the view, less violations, that a pose needs"
    )
    min_curvature: Metres = Field(0.2, description="smallest eigenvalue of the GICP Hessian per inlier, 10 m lever arm")
    rival_held_by: Metres = Field(
        0.12, description="points that hold another distinct pose in its weakest direction, if it is to count as equal"
    )
    firmly_held_by: Metres = Field(
        8.0,
        description="points that hold the pose in its weakest direction, 10 m lever arm: with so many, parallax and "
        "clutter need no further explanation, and what holds it no examination if it is sure and has no rival",
    )
    push_m: PositiveMetres = Field(
        0.3, description="a pose that is to be examined is pushed so far along its weakest direction"
    )
    max_pushed_off_m: PositiveMetres = Field(
        0.01, description="and comes back as near as this by itself, a turn counted 10 m away"
    )
    max_thinned_off_m: PositiveMetres = Field(
        0.3,
        description="and is the same answer if registered with finalist_points only; of a large group few of them are "
        "in the common view",
    )
    max_sigma_m: PositiveMetres = Field(
        0.02, description="and its standard deviation is no larger: what a narrow view holds worse is of little use"
    )
    max_sigma_deg: float = Field(0.2, gt=0.0, description="as max_sigma_m, for turning: 3.5 cm at a distance of 10 m")
    min_explained: Share = Field(
        0.5,
        description="share of the structure in view that must be on measured surfaces, not hidden or in empty space",
    )
    min_explained_firm: Share = Field(0.1, description="the same where the pose is firmly held")


class FineConfig(Section):
    """GICP."""

    engine: Literal["small_gicp", "open3d"] = Field("small_gicp", description="implementation of GICP")
    voxel_size_m: PositiveMetres = Field(
        0.15,
        description="grid on which GICP runs; on a finer one the noise of the ranges bends normals, and so the pose",
    )
    max_points: Count = Field(50_000, description="a cloud with more points is thinned on a coarser grid")
    max_correspondence_distances_m: tuple[PositiveMetres, ...] = Field(
        (0.5, 0.25), min_length=1, description="one GICP run each, from coarse to fine"
    )
    max_iterations: Count = Field(30, description="largest number of iterations of each run")
    rotation_epsilon_rad: PositiveMetres = Field(1e-4, description="converged when a step turns by less (small_gicp)")
    translation_epsilon_m: PositiveMetres = Field(1e-4, description="converged when a step moves by less (small_gicp)")
    gicp_epsilon: PositiveMetres = Field(0.005, description="variance along the normal (open3d)")
    relative_fitness: PositiveMetres = Field(1e-7, description="converged when fitness changes by less (open3d)")
    relative_rmse: PositiveMetres = Field(1e-7, description="converged when the RMSE changes by less (open3d)")
    neighbours: Count = Field(20, description="points from which a covariance is estimated")
    fitness_distance_m: PositiveMetres = Field(
        0.25, description="a point nearer than this to the other cloud is an inlier of fitness and RMSE"
    )


class MergeConfig(Section):
    """Growing the calibrated cloud."""

    mode: Literal["algorithm1", "target_first"] = Field(
        "algorithm1",
        description="algorithm1: the paper's; target_first: all to the target, then the rest to the merged cloud",
    )
    fitness_threshold: Share = Field(0.2, description="a pair with less fitness is not merged")


class RefineConfig(Section):
    """Adjusting all poses to all accepted pairs, and how sure they are."""

    enabled: bool = Field(default=True, description="off: poses stay as the merge left them")
    distance_m: PositiveMetres = Field(0.2, description="points nearer to the other cloud than this hold the pose")
    max_points: Count = Field(20_000, description="points in common that a pose is fitted to; more are thinned evenly")
    min_sigma_m: PositiveMetres = Field(0.005, description="residuals are not believed to be smaller than this")
    outlier_sigma: PositiveMetres = Field(3.0, description="a pair off by this many sigma keeps half its weight")
    max_iterations: Count = Field(20, description="Gauss-Newton steps")
    epsilon: PositiveMetres = Field(1e-9, description="converged when no pose moves by more (rad, m)")


class JointConfig(Section):
    """Several snapshots of one rig as one result."""

    max_disagreement_m: PositiveMetres = Field(
        0.05,
        description="snapshots that place a LiDAR farther apart, beyond refine.outlier_sigma, contradict each other; "
        "right poses differ by millimetres, 5 cm is a wrong one",
    )
    max_disagreement_deg: float = Field(
        0.5, gt=0.0, description="as max_disagreement_m, for turning: 9 cm at a distance of 10 m"
    )


class GroundConfig(Section):
    """The plane under the vehicle."""

    enabled: bool = Field(default=False, description="estimate roll, pitch and z of the base frame")
    max_range_m: PositiveMetres = Field(20.0, description="only points this near to the target LiDAR are looked at")
    distance_m: PositiveMetres = Field(0.05, description="a point nearer than this to the plane belongs to it")
    iterations: Count = Field(1000, description="RANSAC draws")
    max_tilt_deg: float = Field(
        60.0, gt=0.0, le=90.0, description="a plane tilted by more against the target's z axis is not ground"
    )


class RuntimeConfig(Section):
    """How it is computed, not what."""

    threads: Count = Field(1, description="threads; with one the same input gives the same bits")
    seed: int = Field(0, ge=0, description="seed of everything random")


class RecordConfig(Section):
    """What recording.rrd keeps."""

    detail: Literal["full", "normal", "slim"] = Field(
        "normal",
        description="full: every point and match; normal: clouds up to half a million points, a sample of the "
        "matches; slim: without raw clouds and descriptors, small samples of the rest",
    )
    max_megabytes: float = Field(
        100.0,
        gt=0.0,
        description="if it would get larger, all of it is thinned alike, which its log says; full: no limit",
    )


class CalibrationConfig(Section):
    """The whole configuration; one table per stage."""

    preset: Literal["default", "paper"] = Field("default", description="the preset that this started from")
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
    merge: MergeConfig = MergeConfig()
    refine: RefineConfig = RefineConfig()
    joint: JointConfig = JointConfig()
    ground: GroundConfig = GroundConfig()
    runtime: RuntimeConfig = RuntimeConfig()
    record: RecordConfig = RecordConfig()


PRESETS: Mapping[str, Mapping[str, Any]] = {
    "default": {"preset": "default"},
    "paper": {
        "preset": "paper",
        "stillness": {"enabled": False},
        "preprocess": {"voxel_size_m": 0.0, "max_range_m": 1000.0},
        "features": {"voxel_size_m": 0.35, "feature_radius_voxels": 5.0, "max_range_m": 25.0, "orient_normals": False},
        "coarse": {"max_hypotheses": 1, "normal_tolerance_deg": 180.0, "max_baseline_m": 1000.0},
        "verify": {"enabled": False},
        "fine": {
            "engine": "open3d",
            "voxel_size_m": 0.05,
            "max_points": 10_000_000,
            "max_correspondence_distances_m": [1.0],
            "max_iterations": 100,
            "gicp_epsilon": 0.005,
            "relative_fitness": 1e-7,
            "relative_rmse": 1e-7,
            "fitness_distance_m": 1.0,
        },
        "refine": {"enabled": False},
        "merge": {"mode": "algorithm1", "fitness_threshold": 0.2},
    },
}


def preset(name: str) -> CalibrationConfig:
    """The configuration of that preset.

    Raises:
        UnknownNameError: no such preset.
    """
    if name not in PRESETS:
        raise UnknownNameError("preset", name, PRESETS)
    return CalibrationConfig.model_validate(PRESETS[name])


def load_config(path: Path) -> CalibrationConfig:
    """Read a TOML file; keys that it leaves out come from the preset that it names, else from `default`.

    Raises:
        ConfigError: no such file, not TOML, an unknown key, or a value out of range.
        UnknownNameError: no such preset.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ConfigError(f"There is no configuration file at {path}.") from error
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path} is not a TOML file that can be read: {error}.") from error
    base = preset(str(table.get("preset", "default")))
    return _merged(base, table, str(path))


def with_overrides(config: CalibrationConfig, overrides: Iterable[str]) -> CalibrationConfig:
    """Apply ``section.key=value`` texts; the value is read as TOML, else as a bare string.

    Raises:
        ConfigError: a text without ``=``, an unknown key, or a value out of range.
    """
    for override in overrides:
        key, equals, text = override.partition("=")
        if not equals or not key.strip():
            raise ConfigError(
                f"Cannot read the setting '{override}'; expected section.key=value, as in fine.max_iterations=30."
            )
        config = _merged(config, _nested(key.strip().split("."), _toml_value(text.strip())), f"setting '{override}'")
    return config


def _nested(keys: list[str], value: object) -> dict[str, Any]:
    return {keys[0]: value if len(keys) == 1 else _nested(keys[1:], value)}


def _toml_value(text: str) -> object:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _merged(base: CalibrationConfig, table: Mapping[str, Any], where: str) -> CalibrationConfig:
    try:
        return CalibrationConfig.model_validate(_deep_update(base.model_dump(), table))
    except ValidationError as error:
        raise ConfigError(_explain(error, where)) from error


def _deep_update(base: dict[str, Any], table: Mapping[str, Any]) -> dict[str, Any]:
    updated = dict(base)
    for key, value in table.items():
        current = updated.get(key)
        updated[key] = (
            _deep_update(current, value) if isinstance(current, dict) and isinstance(value, Mapping) else value
        )
    return updated


def _explain(error: ValidationError, where: str) -> str:
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    if first["type"] != "extra_forbidden":
        return f"In {where}, {key} is {first['input']!r}: {first['msg'][0].lower()}{first['msg'][1:]}."
    close = _nearest_key(key)
    hint = f" Did you mean '{close}'?" if close else " `multilica config` lists them all."
    return f"In {where}, there is no key '{key}'.{hint}"


def _nearest_key(key: str) -> str:
    keys = known_keys()
    leaves = {known.rpartition(".")[2]: known for known in keys}
    by_path = difflib.get_close_matches(key, keys, n=1, cutoff=0.6)
    by_leaf = difflib.get_close_matches(key.rpartition(".")[2], leaves, n=1, cutoff=0.6)
    return by_path[0] if by_path else leaves[by_leaf[0]] if by_leaf else ""


def known_keys() -> tuple[str, ...]:
    """Every key of the configuration as ``section.key``."""
    keys: list[str] = []
    for name, field in CalibrationConfig.model_fields.items():
        section = field.annotation
        if isinstance(section, type) and issubclass(section, Section):
            keys += [f"{name}.{key}" for key in section.model_fields]
        else:
            keys.append(name)
    return tuple(keys)
