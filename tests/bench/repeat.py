# SPDX-License-Identifier: Apache-2.0
"""The same input twice, in a process of its own each time."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

from multilica.config import CalibrationConfig, with_overrides
from multilica.geometry import FloatArray, RigidTransform
from multilica.pipeline import calibrate
from multilica.results import CalibrationResult
from multilica.simulate import simulate_snapshot
from multilica.snapshot import Snapshot
from tests.bench.support.claims import Claim, print_claims, print_table
from tests.bench.support.workers import run_all
from tests.opencalib import DATA, read_clouds, turned_snapshot

__all__ = ["Difference", "Run", "difference", "main"]

_REAL = "opencalib-0001"
_SIMULATED = ("edgar/street", "helipr/parking", "chain/garage", "sides/open_field")
_THREADS = (1, 2)
_RUNS = 2
_LIMIT = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """What a run left.

    Args:
        digest: of every number of the result but the times.
        verdicts: who was placed, and the outcome and reasons of each pair.
        poses: of the placed LiDARs.
    """

    digest: str
    verdicts: tuple[object, ...]
    poses: Mapping[str, RigidTransform]


@dataclass(frozen=True, slots=True)
class Difference:
    """How the runs of one input differ.

    Args:
        same_bits: all runs with one thread left the same numbers.
        metres, radians: the largest difference of a pose between runs with two threads.
        same_verdicts: all runs placed the same LiDARs, for the same reasons.
    """

    same_bits: bool
    metres: float
    radians: float
    same_verdicts: bool


def main() -> bool:
    """Print per input what differs between runs, and whether the claims stability."""
    inputs = [*([_REAL] if DATA.is_dir() else []), *_SIMULATED]
    cases = list(product(inputs, _THREADS, range(_RUNS)))
    runs = dict(zip(cases, run_all(_run, cases, fresh=True), strict=True))
    differences = [
        difference(*([runs[name, threads, run] for run in range(_RUNS)] for threads in _THREADS)) for name in inputs
    ]
    print_table(
        ("input", "same bits, one thread", "m, two threads", "rad, two threads", "same verdicts"),
        [
            (name, each.same_bits, f"{each.metres:.1e}", f"{each.radians:.1e}", each.same_verdicts)
            for name, each in zip(inputs, differences, strict=True)
        ],
    )
    return print_claims(_claims(differences))


def _claims(differences: Sequence[Difference]) -> list[Claim]:
    total = len(differences)
    same_bits = sum(each.same_bits for each in differences)
    same_verdicts = sum(each.same_verdicts for each in differences)
    metres, radians = max(each.metres for each in differences), max(each.radians for each in differences)
    return [
        Claim("inputs with the same bits, one thread", f"all {total}", str(same_bits), same_bits == total),
        Claim("largest shift, two threads", f"<= {_LIMIT:g} m", f"{metres:.1e} m", metres <= _LIMIT),
        Claim("largest turn, two threads", f"<= {_LIMIT:g} rad", f"{radians:.1e} rad", radians <= _LIMIT),
        Claim("inputs with the same verdicts", f"all {total}", str(same_verdicts), same_verdicts == total),
    ]


def difference(single: Sequence[Run], double: Sequence[Run]) -> Difference:
    """Between runs with one thread, and two runs with two."""
    metres, radians = _apart(*double)
    same_bits = len({run.digest for run in single}) == 1
    return Difference(same_bits, metres, radians, len({run.verdicts for run in (*single, *double)}) == 1)


def _apart(first: Run, second: Run) -> tuple[float, float]:
    shared = first.poses.keys() & second.poses.keys()
    distances = [first.poses[name].distance_to(second.poses[name]) for name in shared]
    return max(metres for metres, _ in distances), max(radians for _, radians in distances)


def _run(case: tuple[str, int, int]) -> Run:
    name, threads, _ = case
    result = calibrate(_snapshot(name), with_overrides(CalibrationConfig(), [f"runtime.threads={threads}"]))
    placed = tuple((each.lidar, each.placed) for each in result.placements)
    verdicts = tuple(
        (pair.target, pair.source, pair.verdict.outcome, *(reason.code for reason in pair.verdict.reasons))
        for pair in result.pairs
    )
    poses = {each.lidar: each.T_target_source for each in result.placements if each.T_target_source is not None}
    return Run(_digest(result), (result.target, placed, verdicts), poses)


def _snapshot(name: str) -> Snapshot:
    if name == _REAL:
        return turned_snapshot(read_clouds(), {})
    return simulate_snapshot(*name.split("/"), seed=1001).snapshot


def _digest(result: CalibrationResult) -> str:
    return hashlib.sha256(b"".join(_numbers(result))).hexdigest()


def _numbers(result: CalibrationResult) -> Iterator[bytes]:
    for each in result.placements:
        yield repr((each.lidar, each.fitness, each.rmse_m, each.reason)).encode()
        yield _bits(None if each.T_target_source is None else each.T_target_source.matrix)
        yield _bits(each.covariance)
    for pair in result.pairs:
        yield repr((pair.fitness, pair.rmse_m, pair.evidence, pair.verdict.outcome, pair.verdict.text)).encode()
        yield _bits(pair.T_target_source.matrix)
        yield _bits(pair.hessian)


def _bits(array: FloatArray | None) -> bytes:
    return b"none" if array is None else array.tobytes()
