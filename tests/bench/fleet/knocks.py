# SPDX-License-Identifier: Apache-2.0
"""`verify` over scenes of vehicles that are as they were, and with one LiDAR knocked.

The reference is a calibration of the same vehicle in another scene, with the errors and the covariance that it has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice, product
from math import radians

import numpy as np
from scipy.spatial.transform import Rotation

from multilica.checks import RigCheck, RigTolerances, Tolerance, check_found
from multilica.checks.comparison import CheckVerdict
from multilica.config import CalibrationConfig, with_overrides
from multilica.errors import UnfitSnapshotError
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.pipeline import calibrate
from multilica.simulate import simulate_snapshot
from multilica.verification import register_from_known
from tests.bench.certainty import SCENES, TARGETS, VEHICLES
from tests.bench.support.claims import Claim, print_claims, print_table
from tests.bench.support.workers import run_all

RIGS = ("edgar", "helipr", "sides", "ring6", "truck")
SCENES_PER_VEHICLE = 20
_KNOCKS = {"unmoved": (0.0, 0.0), "20 mm": (0.02, 0.0), "0.3 deg": (0.0, 0.3), "50 mm": (0.05, 0.0)}
"""Shift (m) and turn (deg) of one LiDAR."""
_TOLERANCES = {"30 mm, 0.3 deg": Tolerance(), "10 mm, 0.15 deg": Tolerance(translation_m=0.01, rotation_deg=0.15)}
_REFERENCES = ("with covariance", "plain")
_DEFAULT, _TIGHT = _TOLERANCES


@dataclass(frozen=True, slots=True)
class _Task:
    """A vehicle; the first scene is for its reference."""

    rig: str
    vehicle: int
    scenes: int


@dataclass(frozen=True, slots=True)
class _Verified:
    """A verdict on a scene: of the knocked LiDAR, or of the rig if none is; `wrong` names others that are outside."""

    rig: str
    scene: str
    knock: str
    tolerance: str
    reference: str
    verdict: CheckVerdict
    wrong: tuple[str, ...]


def main(rigs: Sequence[str] = RIGS, scenes: int = SCENES_PER_VEHICLE) -> bool:
    """Print verdicts by knock and tolerance, and whether the claims hold."""
    tasks = [_Task(rig, vehicle, scenes) for rig, vehicle in zip(rigs, VEHICLES, strict=False)]
    found = [one for of_vehicle in run_all(_verify, tasks) for one in of_vehicle]
    _print_verdicts(found)
    return print_claims(_claims(found))


def _verify(task: _Task) -> list[_Verified]:
    config = with_overrides(CalibrationConfig(), [f"target={TARGETS[task.rig]}", "runtime.workers=1"])
    scenes = islice(product(range(task.scenes), SCENES), task.scenes + 1)
    seeds = [(scene, task.vehicle + 100 + index) for index, (_, scene) in enumerate(scenes)]
    made = simulate_snapshot(task.rig, *seeds[0], build_seed=task.vehicle, sensors="real")
    result = calibrate(made.snapshot, config)
    reference = Extrinsics(
        result.target,
        {name: pose for name, pose in result.poses.items() if name != result.target},
        covariances={one.lidar: one.covariance for one in result.placements if one.covariance is not None},
    )
    found: list[_Verified] = []
    for scene, seed in seeds[1:]:
        made = simulate_snapshot(task.rig, scene, seed, build_seed=task.vehicle, sensors="real")
        rng = np.random.default_rng(seed)
        knocked = str(rng.choice(sorted(reference.T_target_source)))
        for knock, (shift_m, turn_deg) in _KNOCKS.items():
            known = _knocked(reference, knocked, shift_m, turn_deg, rng) if shift_m or turn_deg else reference
            try:
                rig = register_from_known(made.snapshot, known, config)
            except UnfitSnapshotError:
                continue
            for (name, tolerance), told in product(_TOLERANCES.items(), _REFERENCES):
                used = known if told == "with covariance" else replace(known, covariances={})
                check = check_found(rig, made.snapshot, used, RigTolerances(default=tolerance))
                verdict, wrong = _judged(check, knocked if known is not reference else None)
                found.append(_Verified(task.rig, scene, knock, name, told, verdict, wrong))
    return found


def _knocked(known: Extrinsics, lidar: str, shift_m: float, turn_deg: float, rng: np.random.Generator) -> Extrinsics:
    """Return the poses with one LiDAR elsewhere: shifted in a random direction, and turned about a random axis."""
    directions = rng.normal(size=(2, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    turn = Rotation.from_rotvec(radians(turn_deg) * directions[1]).as_matrix()
    motion = RigidTransform.from_rotation_translation(lidar, lidar, turn, shift_m * directions[0])
    return replace(known, T_target_source={**known.T_target_source, lidar: known.T_target_source[lidar] @ motion})


def _judged(check: RigCheck, knocked: str | None) -> tuple[CheckVerdict, tuple[str, ...]]:
    wrong = tuple(name for name in check.moved if name != knocked)
    # With two LiDARs, the one that moved is not told from the root.
    own: Mapping[str, CheckVerdict] = {each.lidar: each.verdict for each in check.lidars}
    return (check.verdict if knocked is None else own.get(knocked, check.verdict)), wrong


def _print_verdicts(found: Sequence[_Verified]) -> None:
    rows = []
    for tolerance, knock, reference in product(_TOLERANCES, _KNOCKS, _REFERENCES):
        some = _of(found, tolerance, knock, reference)
        counts = [str(sum(each.verdict == verdict for each in some)) for verdict in ("within", "undecided", "outside")]
        rows.append((tolerance, knock, reference, str(len(some)), *counts, str(sum(bool(each.wrong) for each in some))))
    print_table(
        ("tolerance", "moved by", "reference", "scenes", "within", "undecided", "outside", "others named"), rows
    )


def _of(found: Sequence[_Verified], tolerance: str, knock: str, reference: str = _REFERENCES[0]) -> list[_Verified]:
    return [each for each in found if (each.tolerance, each.knock, each.reference) == (tolerance, knock, reference)]


def _claims(found: Sequence[_Verified]) -> list[Claim]:
    claims = []
    for tolerance in _TOLERANCES:
        some = _of(found, tolerance, "unmoved")
        alarms = sum(each.verdict == "outside" for each in some)
        claims.append(
            Claim(f"false alarms at {tolerance}", f"<= 1 % of {len(some)}", f"{alarms}", alarms <= 0.01 * len(some))
        )
    for tolerance, knock in ((_DEFAULT, "50 mm"), (_TIGHT, "20 mm"), (_TIGHT, "0.3 deg")):
        some = _of(found, tolerance, knock)
        named = sum(each.verdict == "outside" for each in some)
        claims.append(
            Claim(
                f"knocks of {knock} named at {tolerance}",
                f">= 95 % of {len(some)}",
                f"{named}",
                named >= 0.95 * len(some),
            )
        )
    return claims
