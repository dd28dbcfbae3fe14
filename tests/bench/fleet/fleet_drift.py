# SPDX-License-Identifier: Apache-2.0
"""False alarms and found changes of `find_drift` on simulated series of poses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import radians

import numpy as np
from scipy.stats import binom

from multilica.fleet.drift.drift import DriftEvent, find_drift
from tests.bench.support.claims import Claim, print_claims, print_table
from tests.bench.support.workers import run_all
from tests.fleet.made_series import Motion, Noise, made_fleet, made_vehicle, random_times, with_wrong_logs

_RATE = 0.01
# A true rate equal to the stated one exceeds the limit in one of a thousand measurements.
_CHANCE = 1e-3
_VEHICLES = 20
_FLEETS = {4: 50, 10: 50, 50: 15, 200: 5}
_NOISES = {
    "covariances are right": Noise(),
    "sigma 3 x too small": Noise(factors=(3.0, 3.0)),
    "1 to 3 x too small": Noise(factors=(1.0, 3.0)),
    "scene errors 3 mm, 0.03 deg": Noise(scene_m=0.003, scene_deg=0.03),
    "1 to 3 x, scene errors 2 mm, 0.02 deg": Noise(factors=(1.0, 3.0), scene_m=0.002, scene_deg=0.02),
    "biases, each log in another place": Noise(constant=0.25, place=0.6),
    "biases, all logs in one place": Noise(constant=0.25, place=0.6, depots=1),
    "biases, a new depot half way": Noise(constant=0.25, place=0.6, depots=2),
}
_OF_BIASES = tuple(name for name, noise in _NOISES.items() if noise.constant)
_WRONG = "covariances are right, 2 % of the poses wrong"
_JUMPS = (
    *((f"{mm} mm", 1e-3 * mm, 0.0) for mm in (5, 10, 15, 20, 30, 50)),
    *((f"{deg:g} deg", 0.0, radians(deg)) for deg in (0.05, 0.1, 0.2, 0.3, 0.5)),
)
_SURE = ("30 mm", "50 mm", "0.3 deg", "0.5 deg")
_CREEPS_MM = (1, 2, 5)
_LENGTHS = (5, 10, 50)
# With few logs of large scene errors, a jump is at times as well explained by a creep.
_TOLD = 0.95
_PER_FLEET, _MOVED_FLEETS = 5, 8
_RIG = ("left", "rear", "right")


@dataclass(frozen=True, slots=True)
class _Quiet:
    """A fleet without changes."""

    noise: str
    logs: int
    seed: int


@dataclass(frozen=True, slots=True)
class _Changed:
    """A fleet with some vehicles that change: "jump", "creep" (of one LiDAR), "target" or "lidar" (of three)."""

    kind: str
    size: str
    translation_m: float
    rotation_rad: float
    noise: str
    logs: int
    seed: int

    @property
    def cell(self) -> tuple[str, str, str, int]:
        return self.kind, self.noise, self.size, self.logs


def main() -> bool:
    """Print rates of false alarms and of found changes, and whether the claims hold."""
    claims = _false_alarms()
    claims += _found_changes()
    return print_claims(claims)


def _false_alarms() -> list[Claim]:
    cases = [
        _Quiet(noise, logs, seed)
        for logs, fleets in _FLEETS.items()
        for noise in (*_NOISES, _WRONG)
        for seed in range(fleets)
    ]
    alarms = list(run_all(_alarms, cases))
    rows, claims = [], []
    for noise in (*_NOISES, _WRONG):
        row = [noise]
        for logs, fleets in _FLEETS.items():
            count = sum(
                found for case, found in zip(cases, alarms, strict=True) if (case.noise, case.logs) == (noise, logs)
            )
            series = fleets * _VEHICLES
            limit = int(binom.isf(_CHANCE, series, _RATE))
            row.append(f"{count} of {series}")
            claims.append(Claim(f"false alarms, {logs} logs, {noise}", f"<= {limit}", f"{count}", count <= limit))
        rows.append(row)
    print(f"Series without a change that are reported, at a stated rate of {_RATE:g}:\n")
    print_table(("noise", *(f"{logs} logs" for logs in _FLEETS)), rows)
    return claims


def _alarms(case: _Quiet) -> int:
    rng = np.random.default_rng([31, case.logs, case.seed])
    fleet = made_fleet(rng, _VEHICLES, case.logs, noise=_NOISES.get(case.noise, Noise()))
    if case.noise == _WRONG:
        fleet = [with_wrong_logs(rng, each, 0.02) for each in fleet]
    return len({event.vehicle for event in find_drift(fleet, _RATE)})


def _found_changes() -> list[Claim]:
    cases = list(_changed())
    outcomes: dict[tuple[str, str, str, int], list[tuple[bool, bool, bool]]] = {}
    for case, judged in zip(cases, run_all(_found, cases), strict=True):
        outcomes.setdefault(case.cell, []).extend(judged)
    rows = []
    for kind, noise, size in dict.fromkeys(cell[:3] for cell in outcomes):
        row = [kind, noise, size]
        for logs in _LENGTHS:
            judged = outcomes.get((kind, noise, size, logs), [])
            shares = [f"{100.0 * np.mean([each[i] for each in judged]):.0f}" for i in range(3) if judged]
            row.append(" / ".join(shares) or "-")
        rows.append(row)
    vehicles = _PER_FLEET * _MOVED_FLEETS
    print(
        f"Of {vehicles} vehicles that change, at the default rate, the % that are found, dated to within one log, and"
    )
    print("told by one event of the right kind and part:\n")
    print_table(("change", "noise", "size", *(f"{logs} logs" for logs in _LENGTHS)), rows)
    sure = [
        each
        for (kind, noise, size, logs), judged in outcomes.items()
        if kind == "jump" and size in _SURE and logs >= 10 and "scene" not in noise and not _NOISES[noise].depots
        for each in judged
    ]
    in_depots = [
        each
        for (kind, noise, size, logs), judged in outcomes.items()
        if kind == "jump" and size in _SURE and logs >= 10 and _NOISES[noise].depots
        for each in judged
    ]
    parts = [each for (kind, *_), judged in outcomes.items() if kind in ("target", "lidar") for each in judged]
    return [
        _all("jumps from 30 mm or 0.3 deg at sigma 3 mm, 0.03 deg, 10 logs or more, that are found", sure, 0),
        _all("of these, dated to within one log", sure, 1),
        Claim(
            "the same jumps, all logs in one or two places, that are found",
            f">= {_TOLD:.0%} of {len(in_depots)}",
            f"{sum(each[0] for each in in_depots)}",
            sum(each[0] for each in in_depots) >= _TOLD * len(in_depots),
        ),
        Claim(
            "30 mm jumps of the target or of one of three LiDARs, 10 logs, told by one right event",
            f">= {_TOLD:.0%} of {len(parts)}",
            f"{sum(each[2] for each in parts)}",
            sum(each[2] for each in parts) >= _TOLD * len(parts),
        ),
    ]


def _all(measure: str, judged: Sequence[tuple[bool, bool, bool]], index: int) -> Claim:
    count = sum(each[index] for each in judged)
    return Claim(measure, f"{len(judged)}", f"{count}", count == len(judged))


def _changed() -> Iterator[_Changed]:
    for seed in range(_MOVED_FLEETS):
        for noise in (
            "covariances are right",
            "1 to 3 x too small",
            "1 to 3 x, scene errors 2 mm, 0.02 deg",
            *_OF_BIASES,
        ):
            for logs in _LENGTHS:
                for name, translation_m, rotation_rad in _JUMPS:
                    yield _Changed("jump", name, translation_m, rotation_rad, noise, logs, seed)
                for mm in _CREEPS_MM:
                    yield _Changed("creep", f"{mm} mm per 30 days", 1e-3 * mm, 0.0, noise, logs, seed)
            for kind in ("target", "lidar"):
                yield _Changed(kind, "30 mm", 0.03, 0.0, noise, 10, seed)


def _found(case: _Changed) -> list[tuple[bool, bool, bool]]:
    """Return per vehicle whether its change is found, dated to within one log, and told as what it is."""
    rng = np.random.default_rng([32, case.logs, case.seed])
    noise = _NOISES[case.noise]
    lidars = _RIG if case.kind in ("target", "lidar") else ("left",)
    fleet = made_fleet(rng, _VEHICLES - _PER_FLEET, case.logs, noise=noise, lidars=lidars)
    starts = {}
    for number in range(_PER_FLEET):
        vehicle, times = f"v{number}", random_times(rng, case.logs)
        offset = np.concatenate([case.rotation_rad * _direction(rng), case.translation_m * _direction(rng)])
        index = None if case.kind == "creep" else int(rng.integers(2, case.logs - 1))
        starts[vehicle] = index
        part = "top" if case.kind == "target" else "left"
        fleet += made_vehicle(
            rng,
            case.logs,
            vehicle=vehicle,
            noise=noise,
            lidars=lidars,
            times=times,
            motions={part: Motion(offset, index)},
        )
    events = find_drift(fleet)
    return [
        _judged(case, start, [event for event in events if event.vehicle == vehicle])
        for vehicle, start in starts.items()
    ]


def _judged(case: _Changed, start: int | None, events: Sequence[DriftEvent]) -> tuple[bool, bool, bool]:
    kind = "creep" if case.kind == "creep" else "jump"
    moved = {"target": "target", "lidar": "lidar"}.get(case.kind, "lidar or target")
    dated = any(event.kind == kind and abs(int(event.key[-3:]) - (start or 0)) <= 1 for event in events)
    told = [(event.kind, event.moved) for event in events] == [(kind, moved)]
    return bool(events), dated or (kind == "creep" and told), told


def _direction(rng: np.random.Generator) -> np.ndarray:
    direction = rng.normal(size=3)
    return np.asarray(direction / np.linalg.norm(direction))
