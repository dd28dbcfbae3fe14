# SPDX-License-Identifier: Apache-2.0
"""Scenes that repeat, with cars that move between the scans: no pose may be wrong, or outside its own sigma.

Streets beside them tell how much longer such a scene takes.

A smaller selection: ``python -c "from tests.bench.robustness.hard import main; main(('edgar',), seeds=(901,))"``.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.stats import chi2

from multilica.config import CalibrationConfig
from multilica.errors import UnfitSnapshotError
from multilica.geometry import FloatArray
from multilica.pipeline import calibrate
from multilica.results import LidarPlacement
from multilica.simulate import Simulation, simulate_snapshot
from tests.bench.support.cases import Case
from tests.bench.support.claims import Claim, print_claims, print_table
from tests.bench.support.workers import run_all

RIGS = ("edgar", "helipr", "ring6", "sides", "truck")
WITH_LANES = ("avenue", "bridge", "motorway", "tunnel_niches")
SCENES = (*WITH_LANES, "car_park", "court")
STREET = "street"
FRAMES = (1, 10)
SEEDS = (3076, 3077, 3078, 3079)
"""No threshold was chosen on them; keep it so. Seeds of 901 and above are for development."""
_TRAFFIC = ((), ("traffic:one_way",), ("traffic:both_ways",), ("traffic:queue",))
_RIGHT_M, _RIGHT_RAD = 0.05, float(np.deg2rad(0.5))
_BOUND = float(np.sqrt(chi2.isf(0.001, 6)))
_MOST_BY_STREET = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """One LiDAR other than the target.

    Args:
        offset: (6,) of its pose from the truth, rotation and translation along the target's axes; None without a pose.
    """

    placement: LidarPlacement
    target: str
    offset: FloatArray | None = None

    @property
    def off(self) -> tuple[float, float]:
        """Metres and radians from the truth; only for a pose."""
        assert self.offset is not None
        return float(np.linalg.norm(self.offset[3:])), float(np.linalg.norm(self.offset[:3]))

    @property
    def distance(self) -> float:
        """Mahalanobis distance from the truth; infinity without a covariance."""
        if self.placement.covariance is None or self.offset is None:
            return float("inf")
        return float(np.sqrt(self.offset @ np.linalg.solve(self.placement.covariance, self.offset)))

    @property
    def wrong(self) -> bool:
        """Whether it is placed over 5 cm or 0.5 degrees off."""
        return self.placement.placed and (self.off[0] > _RIGHT_M or self.off[1] > _RIGHT_RAD)

    @property
    def beyond(self) -> bool:
        """Whether the truth lies outside the 99.9 % bound of its own covariance."""
        return self.offset is not None and self.distance > _BOUND


@dataclass(frozen=True, slots=True, eq=False)
class CaseOutcome:
    """A snapshot of some frames per LiDAR and its LiDARs but the target, with the CPU time of the calibration."""

    case: Case
    frames: int
    lidars: tuple[Outcome, ...]
    cpu_s: float


def main(
    rigs: Sequence[str] = RIGS,
    scenes: Sequence[str] = SCENES,
    frames: Sequence[int] = FRAMES,
    seeds: Sequence[int] = SEEDS,
) -> bool:
    """Print figures per scene, every pose that is a lie, and whether there are none."""
    tasks = [
        (Case(rig, scene, seed, _TRAFFIC[seed % len(_TRAFFIC)] if scene in WITH_LANES else ()), count)
        for rig, scene, count, seed in product(rigs, (*scenes, STREET), frames, seeds)
    ]
    measured = run_all(_run, tasks)
    found = [each for each in measured if each.case.scene != STREET]
    header = ("scene", "frames", "LiDARs", "placed", "uncertain", "not placed", "wrong", "beyond 99.9 %")
    rows = [
        (scene, count, *figures(_of(found, scene, count)), f"{time_by_street(measured, scene, count):.1f}")
        for scene, count in product(scenes, frames)
    ]
    columns = (*header, "1 sigma", "2", "3", "CPU s", "longest", "by street")
    print_table(columns, [*rows, ("all", "", *figures(found), "")])
    print_lies(found)
    slowest = max((time_by_street(measured, scene, count) for scene, count in product(scenes, frames)), default=0.0)
    in_time = Claim(
        "mean CPU of a scene by that of a street", f"{_MOST_BY_STREET:g}", f"{slowest:.1f}", slowest <= _MOST_BY_STREET
    )
    return print_claims([*claims([each for of in found for each in of.lidars]), in_time])


def time_by_street(measured: Sequence[CaseOutcome], scene: str, frames: int) -> float:
    """Return the mean CPU time of a scene by that of streets with as many frames; 0 where one of them is missing."""
    here, street = (_of(measured, name, frames) for name in (scene, STREET))
    if not here or not street:
        return 0.0
    return float(np.mean([each.cpu_s for each in here]) / np.mean([each.cpu_s for each in street]))


def _of(found: Sequence[CaseOutcome], scene: str, frames: int) -> list[CaseOutcome]:
    return [each for each in found if (each.case.scene, each.frames) == (scene, frames)]


def _run(task: tuple[Case, int]) -> CaseOutcome:
    case, frames = task
    made = simulate_snapshot(case.rig, case.scene, case.seed, frames=frames, disturbances=case.disturbances)
    start_s = time.process_time()
    try:
        result = calibrate(made.snapshot, CalibrationConfig())
    except UnfitSnapshotError as error:
        target, *others = made.snapshot.names
        lidars = [Outcome(LidarPlacement(name, str(error)), target) for name in others]
    else:
        lidars = [outcome_of(made, result.target, each) for each in result.placements if each.lidar != result.target]
    return CaseOutcome(case, frames, tuple(lidars), time.process_time() - start_s)


def outcome_of(made: Simulation, target: str, placement: LidarPlacement) -> Outcome:
    """Compare a LiDAR with the truth."""
    pose = placement.T_target_source
    if pose is None or not (placement.placed or placement.uncertain):
        return Outcome(placement, target)
    return Outcome(placement, target, pose.offset_from(made.truth.between(pose.target, pose.source)))


def figures(found: Sequence[CaseOutcome]) -> list[object]:
    """Counts, errors by axis within 1, 2 and 3 sigma, and CPU times, in the order of the table."""
    lidars = [each for of in found for each in of.lidars]
    counts = (
        sum(each.placement.placed for each in lidars),
        sum(each.placement.uncertain for each in lidars),
        sum(each.offset is None for each in lidars),
        sum(each.wrong for each in lidars),
        sum(each.beyond for each in lidars),
    )
    times_s = [of.cpu_s for of in found]
    coverage = _coverage(lidars)
    return [
        len(lidars),
        *counts,
        *(f"{share:.1%}" if np.isfinite(share) else "-" for share in coverage),
        f"{np.median(times_s):.1f}",
        f"{max(times_s):.1f}",
    ]


def _coverage(lidars: Sequence[Outcome]) -> list[float]:
    """Shares of the errors by axis, of all that have a pose, within 1, 2 and 3 sigma; nan if none has."""
    sigmas = [
        np.abs(each.offset) / np.sqrt(np.diag(each.placement.covariance))
        for each in lidars
        if each.offset is not None and each.placement.covariance is not None
    ]
    return [float(np.mean(np.concatenate(sigmas) <= limit)) if sigmas else np.nan for limit in (1.0, 2.0, 3.0)]


def claims(lidars: Sequence[Outcome]) -> list[Claim]:
    """No pose may be a lie."""
    poses = [each for each in lidars if each.offset is not None]
    wrong, beyond = sum(each.wrong for each in poses), sum(each.beyond for each in poses)
    return [
        Claim("placed, but over 5 cm or 0.5 deg", "0", f"{wrong} of {len(lidars)}", wrong == 0),
        Claim("placed or uncertain beyond the 99.9 % bound", "0", f"{beyond} of {len(poses)}", beyond == 0),
    ]


def print_lies(found: Sequence[CaseOutcome]) -> None:
    """Print every pose that is wrong or beyond its bound."""
    print_table(
        ("case", "frames", "LiDAR", "target", "status", "off by m", "deg", "Mahalanobis"),
        [_detail(of, each) for of in found for each in of.lidars if each.wrong or each.beyond],
    )


def _detail(of: CaseOutcome, each: Outcome) -> list[object]:
    metres, radians = each.off
    status = "wrong" if each.wrong else each.placement.status
    name = (of.case, of.frames, each.placement.lidar, each.target, status)
    return [*name, f"{metres:.3f}", f"{np.rad2deg(radians):.2f}", f"{each.distance:.1f}"]
