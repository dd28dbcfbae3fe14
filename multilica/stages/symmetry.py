# SPDX-License-Identifier: Apache-2.0
"""What a scene that looks the same turned around makes doubtful."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from multilica.config import VerifyConfig
from multilica.geometry import RigidTransform
from multilica.results import PairRegistration, Reason, Verdict
from multilica.stages.decide import standing_rivals
from multilica.stages.witness import Trial
from multilica.testimony import Testimony

__all__ = ["doubt_by_symmetry"]

_TURNED_RAD = np.deg2rad(45.0)
# The rival is not registered: it may be off by centimetres.
_POSSIBLE_SHARE = 0.01


def doubt_by_symmetry(
    pairs: Sequence[PairRegistration], testify: Trial, config: VerifyConfig
) -> list[PairRegistration]:
    """Leave accepted pairs undecided that a symmetry of the scene, seen by another pair, turns into one as possible.

    Two LiDARs that look apart share nothing in truth. In a hall that looks the same from both ends they fit on each
    other all the same, turned around, and no beam of theirs speaks against it. A pair that sees the whole hall finds
    two poses; the motion from one to the other is the hall's symmetry, and takes the fit of the first two to the pose
    that may be the true one.

    Args:
        pairs: registrations with verdicts and assessments.
        testify: judges a pose between any two LiDARs.

    Returns:
        The pairs in their order, some with another verdict.
    """
    return [_doubted(pair, pairs, testify, config) if pair.verdict.accepted else pair for pair in pairs]


def _doubted(
    pair: PairRegistration, pairs: Sequence[PairRegistration], testify: Trial, config: VerifyConfig
) -> PairRegistration:
    pose = pair.T_target_source
    for other in pairs:
        for lidar in {pair.target, pair.source} & {other.target, other.source}:
            for symmetry in _symmetries(other, lidar, config):
                rival = symmetry @ pose if lidar == pair.target else pose @ symmetry
                if np.linalg.norm(rival.xyz_m) <= config.rival_reach_m and _is_possible(testify(rival)):
                    return replace(pair, verdict=Verdict("undecided", (_reason(pose, rival, other),)))
    return pair


def _symmetries(pair: PairRegistration, lidar: str, config: VerifyConfig) -> Iterator[RigidTransform]:
    """Motions of the scene, in the frame of a LiDAR of the pair, after which it looks the same to both."""
    best = pair.T_target_source
    for rival in standing_rivals(pair.assessments, config):
        if best.distance_to(rival.T_target_source)[1] >= _TURNED_RAD:
            if lidar == pair.target:
                yield rival.T_target_source @ best.inverse()
            else:
                yield best.inverse() @ rival.T_target_source


def _is_possible(testimony: Testimony) -> bool:
    return testimony.violation_share <= _POSSIBLE_SHARE


def _reason(pose: RigidTransform, rival: RigidTransform, witness: PairRegistration) -> Reason:
    metres, radians = pose.distance_to(rival)
    text = (
        f"{witness.target} and {witness.source} find the scene alike when turned by {np.rad2deg(radians):.0f} deg, and "
        f"the pose {metres:.2f} m away that follows contradicts nothing that this pair saw"
    )
    return Reason("ambiguous", 1.0, 0.0, text)
