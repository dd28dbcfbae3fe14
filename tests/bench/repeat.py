# SPDX-License-Identifier: Apache-2.0
"""The same input twice with one worker and with three, in a process of its own each time."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from itertools import product

from multilica.config import CalibrationConfig, with_overrides
from multilica.geometry import FloatArray
from multilica.pipeline import calibrate
from multilica.results import CalibrationResult
from multilica.simulate import simulate_snapshot
from multilica.snapshot import Snapshot
from tests.bench.support.claims import Claim, print_claims, print_table
from tests.bench.support.workers import run_all
from tests.opencalib import DATA, read_clouds, turned_snapshot

_REAL = "opencalib-0001"
_SIMULATED = ("edgar/street", "helipr/parking", "chain/garage", "sides/open_field")
_WORKERS = (1, 3)
_RUNS = 2


def main() -> bool:
    """Print for each input whether all runs left the same bits, and whether the claim holds."""
    inputs = [*([_REAL] if DATA.is_dir() else []), *_SIMULATED]
    cases = list(product(inputs, _WORKERS, range(_RUNS)))
    digests = dict(zip(cases, run_all(_digest_of, cases, fresh=True), strict=True))
    same = {name: len({digests[name, *run] for run in product(_WORKERS, range(_RUNS))}) == 1 for name in inputs}
    print_table(("input", "same bits"), list(same.items()))
    return print_claims([claim(same)])


def claim(same: Mapping[str, bool]) -> Claim:
    """Claim that each input gives the same bits in all runs."""
    workers = " and ".join(map(str, _WORKERS))
    holds = all(same.values())
    return Claim(f"inputs with the same bits, {workers} workers", f"all {len(same)}", str(sum(same.values())), holds)


def _digest_of(case: tuple[str, int, int]) -> str:
    name, workers, _ = case
    result = calibrate(_snapshot(name), with_overrides(CalibrationConfig(), [f"runtime.workers={workers}"]))
    return hashlib.sha256(b"".join(_numbers(result))).hexdigest()


def _snapshot(name: str) -> Snapshot:
    if name == _REAL:
        return turned_snapshot(read_clouds(), {})
    return simulate_snapshot(*name.split("/"), seed=1001).snapshot


def _numbers(result: CalibrationResult) -> Iterator[bytes]:
    yield result.target.encode()
    for each in result.placements:
        yield repr((each.lidar, each.placed, each.fitness, each.rmse_m, each.reason)).encode()
        yield _bits(None if each.T_target_source is None else each.T_target_source.matrix)
        yield _bits(each.covariance)
    for pair in result.pairs:
        yield repr((pair.fitness, pair.rmse_m, pair.evidence, pair.verdict.outcome, pair.verdict.text)).encode()
        yield _bits(pair.T_target_source.matrix)
        yield _bits(pair.hessian)


def _bits(array: FloatArray | None) -> bytes:
    return b"none" if array is None else array.tobytes()
