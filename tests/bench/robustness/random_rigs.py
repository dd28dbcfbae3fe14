# SPDX-License-Identifier: Apache-2.0
"""Vehicles with LiDARs at random places, in random scenes: no pose may be wrong, or outside its own sigma.

Other vehicles: ``python -c "from tests.bench.robustness.random_rigs import main; main(range(1, 101))"``.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from unittest.mock import patch

import numpy as np
from scipy.spatial.transform import Rotation

from multilica.config import CalibrationConfig, with_overrides
from multilica.errors import UnfitSnapshotError, UsageError
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.pipeline import calibrate
from multilica.results import LidarPlacement
from multilica.simulate import RIGS, SCENES, Simulation, simulate_snapshot
from multilica.simulate import models as lidars
from multilica.simulate.rigs import Mount, Rig, articulated_truck, car, shuttle
from multilica.simulate.sensors import SensorModel
from tests.bench.robustness.hard import WITH_LANES, CaseOutcome, claims, figures, outcome_of, print_lies
from tests.bench.support.cases import Case
from tests.bench.support.claims import print_claims, print_table
from tests.bench.support.workers import run_all

SEEDS = range(5241, 5541)
"""No threshold was chosen on them; keep it so. Seeds below 2000 are for development."""
_NAME = "random"
_SPINNING = (
    lidars.OS1_64,
    lidars.OS1_128,
    lidars.OS2_128,
    lidars.ROOF_64,
    lidars.SIDE_32,
    lidars.VLP_16,
)
_SOLID = (lidars.AERIES_II, lidars.AVIA, lidars.FALCON, lidars.LONG_25, lidars.NARROW, lidars.SOLID_70)
_FLOWS = ("traffic:one_way", "traffic:both_ways", "traffic:queue")
_AXES = Rotation.create_group("O").as_matrix()
_SHARE_TURNED = 0.2
"""Of LiDARs that hang upside down, or whose driver has another axis than z up, or gives oblique ones."""


@dataclass(frozen=True, slots=True)
class RandomCase:
    """A vehicle in a scene; all follows from the seed.

    Args:
        axes: rotation (3, 3) of the frames that the drivers report, of those that are turned.
    """

    rig: Rig
    scene: str
    frames: int
    disturbances: tuple[str, ...]
    seed: int
    axes: Mapping[str, np.ndarray]

    @classmethod
    def of(cls, seed: int) -> RandomCase:
        """Draw a case."""
        rng = np.random.default_rng(seed)
        rig = random_rig(rng)
        scene = str(rng.choice(sorted(SCENES)))
        frames = int(rng.choice([1, 3, 8], p=[0.4, 0.4, 0.2]))
        disturbances: tuple[str, ...] = ()
        if scene in WITH_LANES and rng.random() < 0.5:
            disturbances = (str(rng.choice(_FLOWS)),)
        elif rng.random() < 0.2:
            disturbances = ("pedestrians",)
        turned = [mount.name for mount in rig.mounts if rng.random() < _SHARE_TURNED]
        axes = {name: _drawn_axes(rng) for name in turned}
        return cls(rig, scene, frames, disturbances, seed, axes)


def _drawn_axes(rng: np.random.Generator) -> np.ndarray:
    """Draw a turn of a frame, half of them by right angles."""
    if rng.random() < 0.5:
        return np.asarray(_AXES[rng.integers(len(_AXES))])
    return np.asarray(Rotation.random(random_state=rng).as_matrix())


def random_rig(rng: np.random.Generator) -> Rig:
    """Draw a car, a shuttle or a truck with two to five LiDARs of up to three models."""
    kind = rng.choice(["car", "shuttle", "truck"], p=[0.6, 0.3, 0.1])
    if kind == "car":
        size_m = np.array([4.6, 1.8, rng.uniform(1.5, 2.0)])
        body = car(float(size_m[2]), 1.4, 1.2)
    elif kind == "shuttle":
        size_m = rng.uniform([4.0, 1.9, 2.0], [8.0, 2.4, 2.8])
        body = shuttle(*map(float, size_m))
    else:
        size_m, body = np.array([12.6, 2.4, 2.3]), articulated_truck()
    every = (*_SPINNING, *_SOLID)
    models = [every[index] for index in rng.choice(len(every), size=int(rng.integers(1, 4)), replace=False)]
    mounts = (
        _mount(f"lidar_{number}", models[int(rng.integers(len(models)))], size_m, rng)
        for number in range(int(rng.integers(2, 6)))
    )
    return Rig(_NAME, tuple(mounts), body)


def _mount(name: str, sensor: SensorModel, size_m: np.ndarray, rng: np.random.Generator) -> Mount:
    """Put a LiDAR on the roof, at a corner or at a side, a little off the direction that one would choose."""
    length_m, width_m, height_m = map(float, size_m)
    spins = any(sensor is each for each in _SPINNING)
    place = rng.choice(["roof", "corner", "side"], p=[0.4, 0.35, 0.25] if spins else [0.3, 0.5, 0.2])
    side = float(rng.choice([-1.0, 1.0]))
    if place == "roof":
        x_m, y_m, z_m = rng.uniform([-0.7, -0.5, height_m + 0.15], [0.7, 0.5, height_m + 0.45])
        yaw_deg, pitch_deg = rng.choice([0.0, 90.0, 180.0, -90.0]) + rng.normal(0.0, 10.0), rng.uniform(0.0, 12.0)
    elif place == "corner":
        ahead = float(rng.choice([-1.0, 1.0]))
        x_m, y_m, z_m = ahead * (length_m / 2.0 + 0.12), side * (width_m / 2.0 + 0.1), rng.uniform(0.6, 1.2)
        yaw_deg, pitch_deg = np.rad2deg(np.arctan2(side, ahead)) + rng.normal(0.0, 12.0), rng.uniform(-2.0, 6.0)
    else:
        x_m, y_m, z_m = rng.uniform(-0.3, 0.3) * length_m, side * (width_m / 2.0 + 0.15), rng.uniform(0.8, height_m)
        yaw_deg, pitch_deg = 90.0 * side + rng.normal(0.0, 10.0), rng.uniform(0.0, 20.0)
    xyz_m = (float(x_m), float(y_m), float(z_m))
    return Mount(name, sensor, xyz_m, (float(rng.normal(0.0, 2.0)), float(pitch_deg), float(yaw_deg)))


def main(seeds: Sequence[int] = SEEDS) -> bool:
    """Print figures per scene, every pose that is a lie, and whether there are none."""
    found = [each for each in run_all(_run, list(seeds)) if each is not None]
    header = ("scene", "LiDARs", "placed", "uncertain", "not placed", "wrong", "beyond 99.9 %")
    scenes = sorted({each.case.scene for each in found})
    rows = [(scene, *figures([each for each in found if each.case.scene == scene])) for scene in scenes]
    print_table((*header, "1 sigma", "2", "3", "CPU s", "longest"), [*rows, ("all", *figures(found))])
    print_lies(found)
    return print_claims(claims([each for of in found for each in of.lidars]))


def _run(seed: int) -> CaseOutcome | None:
    """Calibrate a random case; None if the scene has no room for the vehicle."""
    drawn = RandomCase.of(seed)
    case = Case(_NAME, drawn.scene, seed, drawn.disturbances)
    with patch.dict(RIGS, {_NAME: drawn.rig}):
        try:
            made = simulate_snapshot(_NAME, drawn.scene, seed, frames=drawn.frames, disturbances=drawn.disturbances)
        except UsageError:
            return None
    made = _with_axes(made, drawn.axes)
    start_s = time.process_time()
    try:
        result = calibrate(made.snapshot, with_overrides(CalibrationConfig(), ["runtime.workers=1"]))
    except UnfitSnapshotError as error:
        target, *others = made.snapshot.names
        outcomes = [outcome_of(made, target, LidarPlacement(name, str(error))) for name in others]
    else:
        placements = [each for each in result.placements if each.lidar != result.target]
        outcomes = [outcome_of(made, result.target, each) for each in placements]
    return CaseOutcome(case, drawn.frames, tuple(outcomes), time.process_time() - start_s)


def _with_axes(made: Simulation, axes: Mapping[str, np.ndarray]) -> Simulation:
    """Return a simulation as drivers report it whose frames are turned."""
    turns = {
        name: RigidTransform.from_rotation_translation(name, name, each, np.zeros(3)) for name, each in axes.items()
    }
    lidars = [
        replace(
            lidar,
            scans=tuple(
                replace(scan, points_m=turns[lidar.name].apply(scan.points_m).astype(np.float32))
                for scan in lidar.scans
            ),
        )
        if lidar.name in turns
        else lidar
        for lidar in made.snapshot.lidars
    ]
    poses = {
        name: pose @ turns[name].inverse() if name in turns else pose
        for name, pose in made.truth.T_target_source.items()
    }
    snapshot = replace(made.snapshot, lidars=tuple(lidars), static_transforms=())
    return Simulation(snapshot, Extrinsics(made.truth.target, poses))
