# SPDX-License-Identifier: Apache-2.0
"""One LiDAR moved, or none: what `check` and `verify` find, and how small a motion they see."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice, product
from math import radians

import numpy as np
from scipy.spatial.transform import Rotation

from multilica.checks import RigCheck, RigTolerances, check_rig, decide_unplaced, verify_snapshot
from multilica.config import CalibrationConfig
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.pipeline import calibrate
from multilica.runs import SavedRun
from multilica.simulate import simulate_snapshot
from tests.bench.support.cases import NEW_SEEDS
from tests.bench.support.claims import Claim, print_claims, print_table
from tests.bench.support.workers import run_all

_RIGS = ("edgar", "helipr", "sides", "chain", "ring6", "sectors8", "truck")
_SCENES = ("street", "parking", "garage")
_CASES = 50
_MOVED_M, _TURNED_DEG = 0.05, 0.5
# Shares of the motion above, for the curve of alarms.
_SHARES = (0.1, 0.2, 0.4, 0.6, 0.8, 1.0)


@dataclass(frozen=True, slots=True)
class _Case:
    """A snapshot whose reference has one LiDAR elsewhere: shifted for even numbers, else turned."""

    number: int
    rig: str
    scene: str
    seed: int

    @property
    def shifted(self) -> bool:
        return self.number % 2 == 0


@dataclass(frozen=True, slots=True)
class _Outcome:
    """Verdicts, by command, on the rig as it is and with one LiDAR moved by each of `_SHARES`."""

    case: _Case
    moved: str
    unchanged: dict[str, RigCheck]
    changed: dict[str, tuple[RigCheck, ...]]


def main() -> bool:
    """Print what is missed, the curve of alarms, and whether the claims hold."""
    outcomes = list(run_all(_try, list(islice(_cases(), _CASES))))
    claims = []
    for command in ("check", "verify"):
        named = [one for one in outcomes if one.changed[command][-1].moved == (one.moved,)]
        quiet = [one for one in outcomes if one.unchanged[command].verdict != "outside"]
        decided = sum(one.unchanged[command].verdict == "within" for one in outcomes)
        print(f"{command}: {decided} of {len(outcomes)} unchanged rigs are within, the others undecided or flagged\n")
        claims += [
            Claim(f"{command}: moved LiDARs that are named", f"{_CASES}", f"{len(named)}", len(named) == _CASES),
            Claim(f"{command}: false alarms", "0", f"{_CASES - len(quiet)}", len(quiet) == _CASES),
        ]
        _print_misses(
            command, [one for one in outcomes if one not in named], [one for one in outcomes if one not in quiet]
        )
    _print_curve(outcomes)
    return print_claims(claims)


def _cases() -> Iterator[_Case]:
    for number, (seed, scene, rig) in enumerate(product(NEW_SEEDS, _SCENES, _RIGS)):
        yield _Case(number, rig, scene, seed)


def _try(case: _Case) -> _Outcome:
    made = simulate_snapshot(case.rig, case.scene, seed=case.seed, frames=2)
    config = CalibrationConfig.model_validate({"runtime": {"workers": 1}})
    known = Extrinsics(made.truth.target, made.truth.T_target_source)
    rng = np.random.default_rng(case.seed + 7 * case.number)
    moved = str(rng.choice(sorted(made.snapshot.names)))
    references = [_moved(known, moved, share, rng, shifted=case.shifted) for share in _SHARES]
    result = calibrate(made.snapshot, config)
    run = SavedRun(str(case), result.target, result.placements)
    tolerances = RigTolerances()

    def checked(reference: Extrinsics) -> RigCheck:
        return decide_unplaced(check_rig(run, reference, tolerances), made.snapshot, reference, tolerances, config)

    return _Outcome(
        case,
        moved,
        {
            "check": checked(known),
            "verify": verify_snapshot(made.snapshot, known, tolerances, config),
        },
        {
            "check": tuple(checked(each) for each in references),
            "verify": tuple(verify_snapshot(made.snapshot, each, tolerances, config) for each in references[-1:]),
        },
    )


def _moved(known: Extrinsics, lidar: str, share: float, rng: np.random.Generator, *, shifted: bool) -> Extrinsics:
    """Return the poses with one LiDAR elsewhere, in a random direction or about a random axis."""
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    motion = np.eye(4)
    if shifted:
        motion[:3, 3] = share * _MOVED_M * direction
    else:
        motion[:3, :3] = Rotation.from_rotvec(radians(share * _TURNED_DEG) * direction).as_matrix()
    poses = {name: known.between(known.target, name).matrix for name in sorted(known.members)}
    poses[lidar] = poses[lidar] @ motion
    root = min(name for name in poses if name != lidar)
    to_root = np.linalg.inv(poses[root])
    return Extrinsics(root, {name: RigidTransform(root, name, to_root @ pose) for name, pose in poses.items()})


def _print_misses(command: str, missed: Sequence[_Outcome], flagged: Sequence[_Outcome]) -> None:
    rows = [(str(one.case), one.moved, "moved", one.changed[command][-1].sentence) for one in missed]
    rows += [(str(one.case), "-", "unchanged", one.unchanged[command].sentence) for one in flagged]
    if rows:
        print_table((f"{command}: case", "LiDAR", "what", "said"), rows)


def _print_curve(outcomes: Sequence[_Outcome]) -> None:
    rows = []
    for shifted in (True, False):
        of_kind = [one for one in outcomes if one.case.shifted == shifted]
        for index, share in enumerate(_SHARES):
            size = f"{1000.0 * share * _MOVED_M:.0f} mm" if shifted else f"{share * _TURNED_DEG:.2f} deg"
            verdicts = [one.changed["check"][index].verdict for one in of_kind]
            rows.append((size, *(str(verdicts.count(each)) for each in ("within", "undecided", "outside"))))
    print_table(("moved by", "within", "undecided", "outside"), rows)
