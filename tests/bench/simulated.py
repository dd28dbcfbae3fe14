# SPDX-License-Identifier: Apache-2.0
"""Simulated rigs with new seeds: placed well, uncertain, or refused for a reason that the truth bears out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from math import degrees

import numpy as np

from multilica.config import CalibrationConfig
from tests.bench.support.cases import NEW_SEEDS, Case, LidarOutcome, run_case
from tests.bench.support.claims import Claim, figure, print_claims, print_table
from tests.bench.support.workers import run_all

RIGS = ("edgar", "helipr", "sides", "chain")
COLUMNS = (
    "LiDARs",
    "good",
    "between",
    "wrong",
    "uncertain",
    "refused",
    "missed",
    "median mm",
    "median deg",
    "within 3 sigma",
    "median normalised",
)
SCENES = ("street", "parking", "garage", "open_field")
MASKS: tuple[tuple[str, ...], ...] = ((), ("ego_masked",))
"""With and without returns of the own vehicle."""
_LEAST_GOOD = 0.97


def main() -> bool:
    """Print figures per rig, every LiDAR that is not good, and whether the claims hold."""
    return report([Case(*each) for each in product(RIGS, SCENES, NEW_SEEDS, MASKS)], _LEAST_GOOD)


def report(cases: Sequence[Case], least_good: float) -> bool:
    """Calibrate the cases and print what became of them, per rig and mask; whether the claims hold."""
    lidars = [lidar for found in run_all(_run, cases) for lidar in found]
    rigs = dict.fromkeys((each.rig, each.disturbances) for each in cases)
    rows = [
        (rig, *mask, [each for each in lidars if (each.case.rig, each.case.disturbances) == (rig, mask)])
        for rig, mask in rigs
    ]
    print_table(
        ("rig", *COLUMNS),
        [(" ".join(name), *figures(some)) for *name, some in (*rows, ("all", lidars))],
    )
    print_details([each for each in lidars if each.standing != "within"])
    return print_claims(
        [
            replace(claim, measure=" ".join((claim.measure, *mask)))
            for mask in MASKS
            for claim in claims([each for each in lidars if each.case.disturbances == mask], least_good)
        ]
    )


def _run(case: Case) -> list[LidarOutcome]:
    return run_case(case, CalibrationConfig(), with_trial=True)


def claims(lidars: Sequence[LidarOutcome], least_good: float) -> list[Claim]:
    """What must be seen to hold of them; of all, at least this share is right or honestly uncertain."""
    count = Counter(each.standing for each in lidars)
    total, wrong, missed = len(lidars), count["wrong"], count["missed"]
    sigmas, normalised = (_own_errors(lidars, name) for name in ("error_sigma", "error_normalised"))
    within, median = float(np.mean(sigmas <= 3.0)), float(np.median(normalised))
    doubtful = [each.comparison.error_sigma for each in lidars if each.uncertain]
    covered = sum(sigma is not None and sigma <= 3.0 for sigma in doubtful)
    good = count["within"] + count["between"] + covered
    return [
        Claim(
            "placed within 5 cm and 0.5 deg, or uncertain within 3 sigma",
            f">= {100 * least_good:g} %",
            f"{good} of {total}, {good / total:.1%}",
            good >= least_good * total,
        ),
        Claim("placed, but over 5 cm, 0.5 deg or 4 sigma", "0", f"{wrong} of {total}", wrong == 0),
        Claim("refused for a reason that the truth does not bear out", "0", str(missed), missed == 0),
        Claim("placed LiDARs within 3 sigma", ">= 95 %", f"{within:.1%}", within >= 0.95),
        Claim(
            "uncertain LiDARs within 3 sigma",
            ">= 95 %",
            f"{covered} of {len(doubtful)}",
            covered >= 0.95 * len(doubtful),
        ),
        Claim("median normalised error", "0.5 to 1.5", f"{median:.2f}", 0.5 <= median <= 1.5),
    ]


def _own_errors(lidars: Sequence[LidarOutcome], name: str) -> np.ndarray:
    """A figure of the placed LiDARs by their own covariance; infinity for one without."""
    errors = [getattr(each.comparison, name) for each in lidars if each.placed]
    return np.array([np.inf if error is None else error for error in errors])


def figures(lidars: Sequence[LidarOutcome]) -> list[object]:
    """Counts and statistics of the placed, in the order of `COLUMNS`."""
    count = Counter(each.standing for each in lidars)
    counts = [count[standing] for standing in ("within", "between", "wrong", "uncertain", "refused", "missed")]
    errors = [each.comparison.error for each in lidars if each.placed]
    if not errors:
        return [len(lidars), *counts, *("-" * 4)]
    metres, radians = (np.median([getattr(error, name) for error in errors]) for name in ("distance_m", "angle_rad"))
    sigmas, normalised = (_own_errors(lidars, name) for name in ("error_sigma", "error_normalised"))
    return [
        len(lidars),
        *counts,
        f"{1e3 * metres:.1f}",
        f"{np.rad2deg(radians):.3f}",
        f"{np.mean(sigmas <= 3.0):.1%}",
        f"{np.median(normalised):.2f}",
    ]


def print_details(lidars: Sequence[LidarOutcome]) -> None:
    """A row per LiDAR, with its errors or the reasons against it."""
    header = ("case", "LiDAR", "outcome", "off by mm", "deg", "sigma", "refused for", "the truth is refused for")
    print_table(header, [_detail(each) for each in lidars])


def _detail(each: LidarOutcome) -> list[object]:
    error = each.comparison.error
    return [
        each.case,
        each.lidar,
        each.standing,
        figure(None if error is None else 1e3 * error.distance_m, 1),
        figure(None if error is None else degrees(error.angle_rad), 3),
        figure(each.comparison.error_sigma, 1),
        ", ".join(each.codes),
        "-" if each.trial is None else "nothing" if each.trial.accepted else ", ".join(each.trial.codes),
    ]
