# SPDX-License-Identifier: Apache-2.0
"""Weights and limits of the evidence, from registered poses of simulated rigs with known truth."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from scipy.optimize import minimize

from multilica.config import CalibrationConfig
from multilica.geometry import FloatArray
from multilica.orchestration.clouds import clean_lidar
from multilica.orchestration.pairs import SearchRequest, prepare_lidar, search_pair
from multilica.results import Registration
from multilica.results.visibility_score import (
    DISTANCE_WEIGHT,
    DISTINCTIVE_WEIGHT,
    FEW_POINTS,
    HIDDEN_WEIGHT,
    PRIOR_LOG_ODDS,
    STRAY_SHARE,
    VIOLATION_WEIGHT,
)
from multilica.simulate import simulate_snapshot
from multilica.workers import Shared
from tests.bench.support.claims import print_table
from tests.bench.support.workers import run_all

_RIGS = ("edgar", "helipr", "sides", "chain", "blind", "sectors8", "truck")
_SCENES = ("street", "parking", "garage", "open_field")
_SEEDS = (31, 32)
_TRUE_M, _TRUE_RAD = 0.1, float(np.deg2rad(1.0))
# Between true and false: GICP ended in the basin of the true pose.
_NEAR_M, _NEAR_RAD = 0.5, float(np.deg2rad(4.0))
_RIDGE = 0.02
_SHOWN = 8


@dataclass(frozen=True, slots=True)
class PoseFigures:
    """What is known of a registered pose; `best` tells whether it is the first of its pair, `lead` by how much."""

    pair: tuple[str, str, str]
    true: bool
    best: bool
    lead: float
    agree: int
    violate: int
    distinctive: float
    structure_agree: int
    structure_occluded: int
    distance_m: float
    evidence: float

    @property
    def terms(self) -> list[float]:
        """What the weights multiply, a 1 for the prior first."""
        seen = self.structure_agree + FEW_POINTS
        return [
            1.0,
            np.log1p(max(0.0, self.distinctive)),
            -np.log1p(max(0.0, self.violate - STRAY_SHARE * self.agree)),
            np.log(seen / (seen + self.structure_occluded)),
            -np.log1p(self.distance_m),
        ]


def main() -> bool:
    """Print the weights beside those in use, and what each limit of evidence and of lead refuses and accepts."""
    poses = [pose for found in run_all(_poses_of, list(product(_RIGS, _SCENES, _SEEDS))) for pose in found]
    used = (PRIOR_LOG_ODDS, DISTINCTIVE_WEIGHT, VIOLATION_WEIGHT, HIDDEN_WEIGHT, DISTANCE_WEIGHT)
    names = ("prior", "distinctive", "violation", "hidden", "distance")
    fitted = fitted_weights(poses)
    print_table(
        ("weight", "fitted", "in use"), [(name, f"{w:.1f}", u) for name, w, u in zip(names, fitted, used, strict=True)]
    )
    best = [pose for pose in poses if pose.best]
    print_table(("min_evidence", "true refused", "false accepted"), _evidence_curve(best))
    false = sorted((pose for pose in best if not pose.true), key=lambda pose: -pose.evidence)
    print_table(
        ("false pose", "evidence", "lead"),
        [(" ".join(pose.pair), f"{pose.evidence:.1f}", f"{pose.lead:.1f}") for pose in false[:_SHOWN]],
    )
    print_table(("min_log_odds_margin", "true refused", "false accepted"), _lead_curve(best))
    return True


def fitted_weights(poses: Sequence[PoseFigures]) -> FloatArray:
    """Fit a logistic regression to the terms; all true, and all false poses of a pair count as one."""
    terms = np.array([pose.terms for pose in poses])
    true = np.array([pose.true for pose in poses])
    groups = [(pose.pair, pose.true) for pose in poses]
    weight = np.array([1.0 / groups.count(group) for group in groups])

    def loss(weights: FloatArray) -> float:
        log_odds = terms @ weights
        miss = np.logaddexp(0.0, -np.where(true, log_odds, -log_odds))
        return float(np.sum(weight * miss) + _RIDGE * np.sum(weights[1:] ** 2))

    return np.asarray(minimize(loss, np.zeros(terms.shape[1])).x)


def _poses_of(case: tuple[str, str, int]) -> list[PoseFigures]:
    rig, scene, seed = case
    config = CalibrationConfig()
    simulation = simulate_snapshot(rig, scene, seed, frames=2)
    lidars = Shared()
    for scans in simulation.snapshot.lidars:
        lidars.add(scans.name, prepare_lidar(clean_lidar(lidars, (scans, config)).cloud, config))
    found: list[PoseFigures] = []
    for pair in combinations(simulation.snapshot.names, 2):
        search = search_pair(lidars, SearchRequest(pair, config.features.voxel_size_m))
        ranked = search.registration.registrations if search and search.registration else ()
        for index, each in enumerate(ranked):
            pose = each.T_target_source
            metres, radians = pose.distance_to(simulation.truth.between(pose.target, pose.source))
            true = metres <= _TRUE_M and radians <= _TRUE_RAD
            if true or metres > _NEAR_M or radians > _NEAR_RAD:
                label = (" ".join(map(str, case)), *pair)
                found.append(_figures(label, each, ranked, true=true, best=index == 0))
    return found


def _figures(
    pair: tuple[str, str, str], each: Registration, ranked: Iterable[Registration], *, true: bool, best: bool
) -> PoseFigures:
    score = each.visibility
    rest = [other.evidence for other in ranked if other is not each]
    return PoseFigures(
        pair=pair,
        true=true,
        best=best,
        lead=each.evidence - max(rest, default=-np.inf),
        agree=score.agree,
        violate=score.violate,
        distinctive=score.distinctive,
        structure_agree=score.structure_agree,
        structure_occluded=score.structure_occluded,
        distance_m=float(np.linalg.norm(each.T_target_source.xyz_m)),
        evidence=each.evidence,
    )


def _evidence_curve(best: Sequence[PoseFigures]) -> list[tuple[object, ...]]:
    return [_row(best, limit, [pose.evidence >= limit for pose in best]) for limit in np.arange(-2.0, 8.1, 1.0)]


def _lead_curve(best: Sequence[PoseFigures]) -> list[tuple[object, ...]]:
    possible = [pose for pose in best if pose.evidence >= CalibrationConfig().acceptance.min_evidence]
    return [_row(possible, limit, [pose.lead >= limit for pose in possible]) for limit in np.arange(0.0, 9.1, 1.0)]


def _row(poses: Sequence[PoseFigures], limit: float, accepted: Sequence[bool]) -> tuple[object, ...]:
    refused = sum(pose.true and not passed for pose, passed in zip(poses, accepted, strict=True))
    wrong = [pose.pair for pose, passed in zip(poses, accepted, strict=True) if passed and not pose.true]
    total = sum(pose.true for pose in poses)
    return f"{limit:g}", f"{refused} of {total}", len(wrong)
