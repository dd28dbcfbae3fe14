# SPDX-License-Identifier: Apache-2.0
"""Simulated snapshots, calibrated and held against their truth."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from multilica.config import CalibrationConfig
from multilica.errors import UnfitSnapshotError
from multilica.pipeline import calibrate
from multilica.results import LidarPlacement
from multilica.runs import SavedRun, Truth, evaluate
from multilica.runs.evaluation import Comparison
from multilica.simulate import Simulation, simulate_snapshot
from tests.bench.support.true_pose_check import Members, Trial, Watch, is_borne_out, try_truth

NEW_SEEDS = (1001, 1002, 1003, 1004, 1005)
"""No threshold was chosen on them; keep it so."""
_UNFIT = "unfit_snapshot"


@dataclass(frozen=True, slots=True)
class Case:
    """What to simulate, and the target to ask for; empty for the one with the most overlap."""

    rig: str
    scene: str
    seed: int
    disturbances: tuple[str, ...] = ()
    target: str = ""

    def __str__(self) -> str:
        return " ".join((self.rig, self.scene, str(self.seed), *self.disturbances))


@dataclass(frozen=True, slots=True, eq=False)
class LidarOutcome:
    """One LiDAR other than the target.

    Args:
        comparison: beside the truth.
        codes: the reasons for which it was refused.
        trial: what the stages say of the true pose of one that was refused; None where that was not asked.
        uncertain: it has a pose, though one whose sigma is above the limit.
    """

    case: Case
    comparison: Comparison
    codes: tuple[str, ...] = ()
    trial: Trial | None = None
    uncertain: bool = False

    @property
    def lidar(self) -> str:
        """Its name."""
        return self.comparison.lidar

    @property
    def placed(self) -> bool:
        """Whether it has a pose that is given as certain, right or wrong."""
        return self.comparison.error is not None and not self.uncertain

    @property
    def standing(self) -> str:
        """`within` (good), `between`, `wrong`, `uncertain`, `refused`, or if the truth speaks against that `missed`."""
        if self.uncertain:
            return "uncertain"
        outcome = self.comparison.outcome
        if outcome == "false_accept":
            return "wrong"
        if outcome != "false_refuse":
            return outcome
        return "refused" if self.trial is None or is_borne_out(self.codes, self.trial) else "missed"


def run_case(case: Case, config: CalibrationConfig, *, with_trial: bool = False) -> list[LidarOutcome]:
    """Simulate, calibrate with one thread, compare; with the trial of the truth for LiDARs that were refused."""
    simulation = simulate_snapshot(case.rig, case.scene, case.seed, disturbances=case.disturbances)
    config = config.model_copy(update={"target": case.target})
    watch = Watch()
    try:
        result = calibrate(simulation.snapshot, config, watch)
    except UnfitSnapshotError as error:
        return _all_refused(case, simulation, str(error))
    groups = () if result.status == "complete" else result.decisions[-1].groups
    trials = try_truth(watch, groups, simulation.truth, config) if with_trial and groups else {}
    compared = _compared(case, result.target, result.placements, simulation)
    names = [one.lidar for one in compared]
    return [
        LidarOutcome(case, one, _codes(watch, groups, name), trials.get(name), one.uncertain)
        for name, one in zip(names, compared, strict=True)
    ]


def _all_refused(case: Case, simulation: Simulation, reason: str) -> list[LidarOutcome]:
    """A whole snapshot refused, which no simulated one deserves: the vehicle stands still."""
    target, *others = simulation.snapshot.names
    placements = [LidarPlacement(name, reason) for name in others]
    trial = Trial(accepted=True, codes=())
    return [LidarOutcome(case, one, (_UNFIT,), trial) for one in _compared(case, target, placements, simulation)]


def _compared(
    case: Case, target: str, placements: Iterable[LidarPlacement], simulation: Simulation
) -> tuple[Comparison, ...]:
    truth = Truth(simulation.snapshot.source, simulation.truth)
    return evaluate([SavedRun(str(case), target, tuple(placements))], [truth]).lidars


def _codes(watch: Watch, groups: Sequence[Members], lidar: str) -> tuple[str, ...]:
    """Why the LiDAR's group was not joined to the target's, the first."""
    return next((watch.refusal(groups[0], group) for group in groups[1:] if lidar in group), ())
