# SPDX-License-Identifier: Apache-2.0
"""One drive: what is found beside the truth."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import numpy as np
from scipy.stats import chi2

from multilica.config import CalibrationConfig, with_overrides
from multilica.drive_calibration import CalibrateAlone, calibrate_alone, calibrate_jointly
from multilica.errors import UsageError
from multilica.events import ignore
from multilica.extrinsics import Extrinsics
from multilica.geometry import FloatArray, RigidTransform
from multilica.multi_snapshot import SnapshotRun, join
from multilica.orchestration import open_calibration_workers
from multilica.orchestration.earlier_stops import EarlierStops
from multilica.orchestration.pairs import PreparedLidar
from multilica.results import CalibrationResult, DriveView, Knock, LidarPlacement, ViewPair
from multilica.simulate import RIGS, SimulatedDrive, simulate_drive
from multilica.snapshot import Snapshot
from tests.bench.drives.cases import DriveCase
from tests.bench.drives.ways import in_plane_mm, offsets_of_hand_eye_m, ways_of

_FRAMES = 3
_KNOCK_M, _KNOCKED_FROM = 0.02, 2
_RIGHT_M, _RIGHT_DEG = 0.02, 0.2
_WRONG_M, _WRONG_DEG = 0.05, 0.5
_WRONG_LINK_M, _WRONG_LINK_DEG = 0.3, 3.0
_BOUND = float(np.sqrt(chi2.isf(0.001, 6)))
# A scene may have no room for a drive; the next seed is another one.
_SEED_STEP, _TRIES = 400, 20


@dataclass(frozen=True, slots=True, eq=False)
class LidarOutcome:
    """One LiDAR other than the target.

    Args:
        offset: (6,) of its pose from the truth, rotation and translation along the target's axes; None without a pose.
        distance: Mahalanobis distance from the truth.
        alone_mm: error without links between the stops; None where it is not placed then.
        in_plane_mm: horizontal error of ours and of the peer; None where the frames on the way are not simulated.
    """

    lidar: str
    status: str
    offset: FloatArray | None = None
    distance: float = float("nan")
    alone_mm: float | None = None
    in_plane_mm: tuple[float, float] | None = None

    @property
    def placed(self) -> bool:
        """Whether it is placed."""
        return self.offset is not None and self.status == "placed"

    @property
    def uncertain(self) -> bool:
        """Whether it has a pose with a large sigma."""
        return self.offset is not None and self.status != "placed"

    @property
    def error_mm(self) -> float:
        """Distance from the truth; nan without a pose."""
        return float("nan") if self.offset is None else 1e3 * float(np.linalg.norm(self.offset[3:]))

    @property
    def off_deg(self) -> float:
        """Angle from the truth; nan without a pose."""
        return float("nan") if self.offset is None else float(np.rad2deg(np.linalg.norm(self.offset[:3])))

    @property
    def right(self) -> bool:
        """Whether it is placed within 2 cm and 0.2 degrees."""
        return self.placed and self.error_mm <= 1e3 * _RIGHT_M and self.off_deg <= _RIGHT_DEG

    @property
    def wrong(self) -> bool:
        """Whether it is placed over 5 cm or 0.5 degrees off."""
        return self.placed and (self.error_mm > 1e3 * _WRONG_M or self.off_deg > _WRONG_DEG)

    @property
    def beyond(self) -> bool:
        """Whether the truth lies outside the 99.9 % bound of its own covariance."""
        return self.offset is not None and not self.distance <= _BOUND


@dataclass(frozen=True, slots=True)
class LinkOutcome:
    """A link that poses rest on, with its distance from the truth."""

    name: str
    off_m: float
    off_deg: float

    @property
    def wrong(self) -> bool:
        """Whether it links another place."""
        return self.off_m > _WRONG_LINK_M or self.off_deg > _WRONG_LINK_DEG


@dataclass(frozen=True, slots=True, eq=False)
class DriveOutcome:
    """What was found of a drive.

    Args:
        links: number of the links that are used.
        knocked: the LiDAR that moved; empty if none did.
        one_stop_s: CPU time of the first stop alone.
    """

    case: DriveCase
    target: str
    lidars: tuple[LidarOutcome, ...]
    links: int
    wrong_links: tuple[LinkOutcome, ...]
    knocks: tuple[Knock, ...]
    knocked: str
    cpu_s: float
    one_stop_s: float

    @property
    def all_placed(self) -> bool:
        """Whether all LiDARs are placed."""
        return all(each.placed for each in self.lidars)

    @property
    def dated(self) -> bool:
        """Whether the knock, and no other, is found, with its LiDAR and its time."""
        times = f"stop {_KNOCKED_FROM}", f"stop {_KNOCKED_FROM + 1}"
        return [(each.lidar, each.before, each.after) for each in self.knocks] == [(self.knocked, *times)]


def run_drive(case: DriveCase) -> DriveOutcome:
    """Simulate a drive, and calibrate with links between its stops and without."""
    made, knocked = simulate(case)
    config = with_overrides(CalibrationConfig(), ["runtime.workers=1"])
    with open_calibration_workers(config) as workers:
        start_s = time.process_time()
        runs: list[SnapshotRun] = []
        ends_s: list[float] = []

        def alone_at(name: str, snapshot: Snapshot) -> CalibrateAlone:
            def one(prepared: dict[str, PreparedLidar] | None, earlier: EarlierStops) -> SnapshotRun:
                runs.append(calibrate_alone(name, snapshot, config, ignore, workers, inf, prepared, earlier))
                ends_s.append(time.process_time())
                return runs[-1]

            return one

        stops = {f"stop {number}": alone_at(f"stop {number}", each) for number, each in enumerate(made.snapshots, 1)}
        joint = calibrate_jointly(stops, config, workers, inf, ways_of(made) if case.row.logged else {})
        cpu_s = time.process_time() - start_s
    result = joint.result
    without = join(runs, with_overrides(config, [f"target={result.target}"]))
    alone = {each.lidar: each for each in without.placements}
    by_hand_eye = offsets_of_hand_eye_m(made, result.target) if case.row.logged else {}
    lidars = [
        _lidar(made, result, each, alone[each.lidar], by_hand_eye.get(each.lidar))
        for each in result.placements
        if each.lidar != result.target
    ]
    used = _used_links(made, result, joint.links)
    return DriveOutcome(
        case,
        result.target,
        tuple(lidars),
        len(used),
        tuple(each for each in used if each.wrong),
        result.knocks,
        knocked,
        cpu_s,
        ends_s[0] - start_s,
    )


def simulate(case: DriveCase) -> tuple[SimulatedDrive, str]:
    """Simulate a drive, and return it with the LiDAR that moves, if one does."""
    for number in range(_TRIES):
        seed = case.seed + _SEED_STEP * number
        knocked, moved = _knock(case, seed) if case.row.knock else ("", {})
        try:
            made = simulate_drive(
                case.rig,
                case.scene,
                seed,
                route=case.route,
                stops=case.stops,
                frames=_FRAMES,
                parked=case.row.parked,
                moved=moved,
                moved_from=_KNOCKED_FROM if moved else 0,
                with_log=case.row.logged,
            )
        except UsageError:
            continue
        return made, knocked
    raise UsageError(f"Found no room for {case} with {_TRIES} seeds.")


def _knock(case: DriveCase, seed: int) -> tuple[str, dict[str, RigidTransform]]:
    rng = np.random.default_rng(seed)
    lidar = str(rng.choice(sorted(mount.name for mount in RIGS[case.rig].mounts)))
    direction = rng.normal(size=3)
    shift_m = _KNOCK_M * direction / np.linalg.norm(direction)
    return lidar, {lidar: RigidTransform.from_rotation_translation(lidar, lidar, np.eye(3), shift_m)}


def _lidar(
    made: SimulatedDrive,
    result: CalibrationResult,
    found: LidarPlacement,
    alone: LidarPlacement,
    hand_eye_m: FloatArray | None,
) -> LidarOutcome:
    target = result.target
    offset = offset_of(found, target, made.truths, result.knocks)
    if offset is None:
        return LidarOutcome(found.lidar, found.status)
    distance = _distance(offset, found)
    without = offset_of(alone, target, made.truths) if alone.placed else None
    alone_mm = None if without is None else 1e3 * float(np.linalg.norm(without[3:]))
    in_plane = None
    if hand_eye_m is not None:
        in_plane = in_plane_mm(made, target, offset[3:]), in_plane_mm(made, target, hand_eye_m)
    return LidarOutcome(found.lidar, found.status, offset, distance, alone_mm, in_plane)


def offset_of(
    found: LidarPlacement, target: str, truths: Sequence[Extrinsics], knocks: Sequence[Knock] = ()
) -> FloatArray | None:
    """Return the offset from the nearest truth of the stops that knocks do not leave out; None without a pose."""
    pose = found.T_target_source
    if pose is None or not (found.placed or found.uncertain):
        return None
    left_out = {stop for knock in knocks if knock.lidar in (target, found.lidar) for stop in knock.left_out}
    counting = [truth for number, truth in enumerate(truths, 1) if f"stop {number}" not in left_out] or truths
    offsets = [pose.offset_from(truth.between(target, found.lidar)) for truth in counting]
    return min(offsets, key=lambda offset: _distance(offset, found))


def _distance(offset: FloatArray, found: LidarPlacement) -> float:
    """Return the Mahalanobis distance of an offset by the covariance of the pose; inf without one."""
    if found.covariance is None:
        return float("inf")
    return float(np.sqrt(offset @ np.linalg.solve(found.covariance, offset)))


def _used_links(made: SimulatedDrive, result: CalibrationResult, links: Sequence[ViewPair]) -> list[LinkOutcome]:
    """Return the links that poses rest on."""
    used = {(each.target, each.target_stop, each.source, each.source_stop) for each in result.links if each.used}
    return [link_outcome(made, link) for link in links if (*link.target, *link.source) in used]


def link_outcome(made: SimulatedDrive, link: ViewPair) -> LinkOutcome:
    """Compare a link with the truth."""
    pose = link.registration.T_target_source
    target, source = (_in_first_stop(made, view) for view in (link.target, link.source))
    truth = target.inverse() @ source
    off_m, off_rad = pose.distance_to(RigidTransform(pose.target, pose.source, truth.matrix))
    return LinkOutcome(f"{link.target.label} - {link.source.label}", off_m, float(np.rad2deg(off_rad)))


def _in_first_stop(made: SimulatedDrive, view: DriveView) -> RigidTransform:
    """Return the true pose of a LiDAR at a stop in the vehicle's frame at the first one."""
    index = int(view.stop.split()[-1]) - 1
    return made.T_first_stop_base[index] @ made.truths[index].T_target_source[view.lidar]
