# SPDX-License-Identifier: Apache-2.0
"""Whether the explanation of a run names what went wrong in its simulation."""

from __future__ import annotations

import math
import re
from contextlib import suppress
from dataclasses import dataclass

from multilica.diagnosis import Explanation, explain
from multilica.errors import UnfitSnapshotError
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.pipeline import calibrate
from multilica.simulate import simulate_snapshot
from multilica.sinks.run_state import RunState
from tests.bench.support.claims import Claim, print_claims, print_table

SEEDS = (3, 4)
FRAMES = 3


@dataclass(frozen=True, slots=True)
class Case:
    """What goes wrong, and what is to be said of it.

    Args:
        lidars: those that the cause is to be named for; none if it is for the whole run.
        warning: what is said of a LiDAR that was placed all the same.
        turned: the LiDAR of which the prior has it that it looks the other way.
    """

    name: str
    rig: str
    scene: str
    causes: tuple[str, ...]
    lidars: tuple[str, ...] = ()
    disturbances: tuple[str, ...] = ()
    warning: str = ""
    turned: str = ""


CASES = (
    Case("no overlap", "blind", "street", ("no_overlap", "contradiction"), ("rear",)),
    Case("symmetric garage", "sides", "symmetric_garage", ("ambiguous",), ("left", "right")),
    Case("tunnel", "edgar", "tunnel", ("ambiguous", "not_observable"), ("front",)),
    Case("moving vehicle", "sides", "street", ("moving_vehicle",), (), ("moving",)),
    Case("dead sensor", "sides", "street", ("dead_sensor",), ("left",), ("dead:left",)),
    Case("dirty sensor", "sides", "street", ("dirty_sensor",), ("left",), ("dirty:left",), "dirty or covered window"),
    Case("backwards", "sides", "street", ("against_prior",), ("left",), (), "mounted backwards", "left"),
)


def main() -> bool:
    """Print the table; whether every cause is named."""
    told = [(case, seed, _explained(case, seed)) for case in CASES for seed in SEEDS]
    named = [_names(case, explanation) for case, _, explanation in told]
    rows = [
        (case.name, seed, "yes" if right else "no", " ".join((explanation.headline, *explanation.warnings)))
        for (case, seed, explanation), right in zip(told, named, strict=True)
    ]
    print_table(("what goes wrong", "seed", "named", "headline, warnings"), rows)
    return print_claims([Claim("causes named", str(len(named)), str(sum(named)), all(named))])


def _explained(case: Case, seed: int) -> Explanation:
    simulation = simulate_snapshot(case.rig, case.scene, seed, frames=FRAMES, disturbances=case.disturbances)
    state = RunState()
    with suppress(UnfitSnapshotError):
        calibrate(simulation.snapshot, None, state, _turned(simulation.truth, case.turned) if case.turned else None)
    document = state.document
    if document is None:
        raise RuntimeError(f"{case.name} left no document")
    return explain(document)


def _turned(truth: Extrinsics, lidar: str) -> Extrinsics:
    """The truth, but for one LiDAR as if it were mounted the other way round."""
    half_turn = RigidTransform.from_xyz_rpy(lidar, lidar, (0.0, 0.0, 0.0), (0.0, 0.0, math.pi))
    poses = truth.T_target_source
    return Extrinsics(truth.target, {**poses, lidar: poses[lidar] @ half_turn})


def _names(case: Case, told: Explanation) -> bool:
    """Of a LiDAR that was placed all the same, a warning names it."""
    if not case.lidars:
        return told.cause in case.causes
    missing = {one.lidar for one in told.missing if one.cause in case.causes}
    warned = {name for name in case.lidars for text in told.warnings if re.match(f"{name} .*{case.warning}", text)}
    return set(case.lidars) <= missing | (warned if case.warning else set())
