# SPDX-License-Identifier: Apache-2.0
"""Scenes that are hard or cannot be decided, each with what physics lets expect."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from multilica.config import CalibrationConfig
from tests.bench.simulated import print_details
from tests.bench.support.cases import NEW_SEEDS, Case, LidarOutcome, run_case
from tests.bench.support.claims import Claim, print_claims, print_table
from tests.bench.support.workers import run_all

_PLACED = "placed"


@dataclass(frozen=True, slots=True)
class Expectation:
    """What every LiDAR of a rig may end as: `placed`, or one of its reasons for refusal is among these."""

    rig: str
    scene: str
    disturbance: str
    allowed: tuple[str, ...]
    why: str

    def is_met(self, lidar: LidarOutcome) -> bool:
        """Whether the LiDAR ended as one of these; a wrong pose never does, nor a refusal that the truth contradicts.

        An uncertain pose, or a true one that would be, is one that is not observable enough.
        Where the beams speak against the pose that was found, what stands in the way of the true one is the reason.
        """
        if lidar.placed:
            return lidar.standing != "wrong" and _PLACED in self.allowed
        if lidar.uncertain:
            return "not_observable" in self.allowed
        codes = {*lidar.codes, *(() if lidar.trial is None else lidar.trial.codes)}
        if "imprecise" in codes:
            codes.add("not_observable")
        return lidar.standing != "missed" and not codes.isdisjoint(self.allowed)


_LITTLE = ("too_little_evidence", "not_observable")
_WEDGE = (
    "neighbours share a wedge of 9 deg: what stands in it decides, or else too little does, or it is like another wedge"
)
_HALF = "the free half of the view and the truck itself accept"
_STRAYS = "stray returns lie on no surface, so they neither agree nor violate"
_WALKERS = "what moves is dropped, the scene behind decides"
_TUNNEL = "every cross-section is the same: nothing holds the position along it"
_FENCE = "a plane and a straight line: nothing holds the position along the fence, or little but the plane is shared"
_TURNED = "the scene is the same after half a turn: two poses explain as much"
EXPECTED = (
    Expectation("chain", "parking", "low_overlap", (_PLACED, *_LITTLE, "ambiguous"), _WEDGE),
    Expectation("chain", "garage", "low_overlap", (_PLACED, *_LITTLE, "ambiguous"), _WEDGE),
    Expectation("edgar", "street", "truck", (_PLACED,), _HALF),
    Expectation("sides", "parking", "truck", (_PLACED,), _HALF),
    Expectation("helipr", "parking", "rain", (_PLACED,), _STRAYS),
    Expectation("sides", "street", "rain", (_PLACED,), _STRAYS),
    Expectation("helipr", "street", "pedestrians", (_PLACED,), _WALKERS),
    Expectation("sides", "parking", "pedestrians", (_PLACED,), _WALKERS),
    Expectation("sides", "tunnel", "", ("not_observable",), _TUNNEL),
    Expectation("helipr", "tunnel", "", ("not_observable",), _TUNNEL),
    Expectation("sides", "fence_field", "", ("not_observable", "too_little_evidence"), _FENCE),
    Expectation("helipr", "fence_field", "", ("not_observable", "too_little_evidence"), _FENCE),
    Expectation("sides", "symmetric_garage", "", ("ambiguous",), _TURNED),
    Expectation("edgar", "symmetric_garage", "", ("ambiguous",), _TURNED),
)
_SEEDS = NEW_SEEDS[:3]


def main() -> bool:
    """Print what was expected, what came out, and whether that holds."""
    cases = [_case(each, seed) for each in EXPECTED for seed in _SEEDS]
    found = run_all(_run, cases)
    per_row = [
        [lidar for lidars in found[start : start + len(_SEEDS)] for lidar in lidars]
        for start in range(0, len(found), len(_SEEDS))
    ]
    rows = list(zip(EXPECTED, per_row, strict=True))
    print_table(("case", "because"), [(_name(each), each.why) for each in EXPECTED])
    print_details([lidar for _, lidars in rows for lidar in lidars if lidar.standing != "within"])
    return print_claims([_claim(expected, lidars) for expected, lidars in rows])


def _case(expected: Expectation, seed: int) -> Case:
    return Case(expected.rig, expected.scene, seed, (expected.disturbance,) if expected.disturbance else ())


def _run(case: Case) -> list[LidarOutcome]:
    return run_case(case, CalibrationConfig(), with_trial=True)


def _name(expected: Expectation) -> str:
    return " ".join(filter(None, (expected.rig, expected.scene, expected.disturbance)))


def _claim(expected: Expectation, lidars: Sequence[LidarOutcome]) -> Claim:
    allowed = [*(word for word in expected.allowed if word == _PLACED)]
    reasons = [word for word in expected.allowed if word != _PLACED]
    if reasons:
        allowed.append(f"refused: {' or '.join(reasons)}")
    return Claim(_name(expected), ", ".join(allowed), _counted(lidars), all(expected.is_met(lidar) for lidar in lidars))


def _counted(lidars: Sequence[LidarOutcome]) -> str:
    counts = Counter(_outcome(lidar) for lidar in lidars)
    return "; ".join(f"{count} {outcome}" for outcome, count in counts.most_common())


def _outcome(lidar: LidarOutcome) -> str:
    if lidar.placed:
        return "wrong" if lidar.standing == "wrong" else _PLACED
    if lidar.uncertain:
        return "uncertain"
    return f"refused: {' and '.join(lidar.codes) or 'no pose found'}"
