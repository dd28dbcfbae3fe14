# SPDX-License-Identifier: Apache-2.0
"""What each cause is called, and what helps against it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

from multilica.explanation.explanation import Cause

__all__ = ["ADVICE", "PRIOR_ADVICE", "REASON_WORDS", "WORDS", "by_weight", "cause_of_codes", "step_of"]

_BY_CODE: Sequence[tuple[str, Cause]] = (
    ("against_prior", "against_prior"),
    ("too_little_overlap", "no_overlap"),
    ("too_little_evidence", "no_overlap"),
    ("empty_space_violated", "contradiction"),
    ("place_proven_empty", "contradiction"),
    ("cycle_contradicted", "two_places"),
    ("ambiguous", "ambiguous"),
    ("not_observable", "not_observable"),
    ("structure_unexplained", "unexplained"),
    ("too_far_apart", "unexplained"),
    ("low_fitness", "low_fitness"),
)
"""The first code that a verdict has decides."""

REASON_WORDS: Mapping[str, str] = MappingProxyType(
    {
        "against_prior": "contradicts the prior",
        "too_little_overlap": "too little overlap",
        "too_little_evidence": "too little evidence",
        "empty_space_violated": "points in empty space",
        "place_proven_empty": "stands in empty space",
        "cycle_contradicted": "another pair contradicts it",
        "ambiguous": "another pose not ruled out",
        "not_observable": "free to slide",
        "structure_unexplained": "walls and objects unexplained",
        "too_far_apart": "LiDARs too far apart",
        "low_fitness": "low fitness",
    }
)
"""A reason by its code, short enough for a label."""

WORDS: Mapping[Cause, str] = MappingProxyType(
    {
        "dead_sensor": "it returned nothing at all (a dead sensor, or an empty topic)",
        "no_returns_in_range": "all of its returns are too near or too far to be used",
        "dirty_sensor": "its window is dirty or covered",
        "moving_vehicle": "the vehicle moved while the snapshot was taken",
        "unfit_input": "the snapshot holds too little to calibrate",
        "no_overlap": "it shares too few surfaces with the others (no overlap)",
        "contradiction": "every pose that was found puts surfaces where beams proved empty space",
        "ambiguous": "the scene looks the same from two places (a symmetric scene)",
        "not_observable": "the scene lets it slide in one direction without the fit getting worse",
        "unexplained": "the best pose leaves too much of what is in view unexplained (a chance agreement)",
        "low_fitness": "too few of its points lie near those of the others",
        "against_prior": "it sits otherwise than its prior claims, as if mounted the other way round",
        "two_places": "two other LiDARs put it at different places, and nothing tells which is true",
        "not_in_rig": "it fits another LiDAR by itself, but not the rig that was merged",
        "not_joined": "it fits another LiDAR that is itself not placed",
        "disputed": "the snapshots contradict each other, and no majority settles it",
        "stopped_early": "the run was to stop before LiDARs are placed",
        "unfinished": "the run ended before it was placed",
        "unknown": "no registration with another LiDAR was accepted",
    }
)

_MORE_OVERLAP = "a place with structure in the common field of view, or a LiDAR that sees part of both sides"
_OTHER_PLACE = "another place, with walls, poles or parked cars at uneven distances around the vehicle"
_TOGETHER = "a second snapshot, taken elsewhere, calibrated together with this one"
PRIOR_ADVICE = "the pose from a drawing or an earlier calibration as one more candidate (--prior)"
"""It can show a pose that the descriptors miss; of two that the scene does not tell apart it prefers none."""
_MORE_FRAMES = "more frames (--frames), so that sparse surfaces are seen"

_STEPS_WITHOUT_PAIR: Mapping[Cause, str] = MappingProxyType(
    {
        "dead_sensor": "preprocess: there were no returns",
        "no_returns_in_range": "preprocess: no return was kept",
        "dirty_sensor": "preprocess: what the window hides is missing",
        "disputed": "joint: the snapshots beside each other",
        "not_joined": "joint: the snapshots beside each other",
        "unknown": "joint: the snapshots beside each other",
    }
)

ADVICE: Mapping[Cause, tuple[str, ...]] = MappingProxyType(
    {
        "dead_sensor": ("check power, network and driver of the LiDAR, then whether `multilica inspect` shows points",),
        "no_returns_in_range": ("look at preprocess.min_range_m and preprocess.max_range_m, and for a cover on it",),
        "dirty_sensor": ("clean the window, take off covers, and record again",),
        "moving_vehicle": (
            "record while the vehicle stands still, or choose another window with --start or --window auto",
        ),
        "unfit_input": ("a recording with at least two LiDARs that have returns; see `multilica inspect`",),
        "no_overlap": (_MORE_OVERLAP, _MORE_FRAMES, PRIOR_ADVICE),
        "contradiction": (
            "a scene where nothing moves, and a look at the red points of the pair in the recording",
            _MORE_OVERLAP,
            PRIOR_ADVICE,
        ),
        "ambiguous": (_OTHER_PLACE, _TOGETHER),
        "not_observable": (_OTHER_PLACE, _MORE_OVERLAP, _MORE_FRAMES),
        "unexplained": (_MORE_OVERLAP, _OTHER_PLACE, PRIOR_ADVICE),
        "low_fitness": (_MORE_OVERLAP, "preset default, which judges by more than fitness"),
        "against_prior": ("check how the LiDAR is mounted, and the sign of its angles in the prior",),
        "two_places": (_OTHER_PLACE, _TOGETHER, _MORE_OVERLAP),
        "not_in_rig": (_MORE_OVERLAP, _OTHER_PLACE, _TOGETHER),
        "not_joined": (_MORE_OVERLAP, "another target (--target) among the LiDARs that it fits"),
        "disputed": (
            "one more snapshot, from another place, for a majority",
            "a look at what each snapshot gives by itself, in the directory of its name",
        ),
        "stopped_early": ("run again without --until",),
        "unfinished": ("run again; every finished stage is in the recording",),
        "unknown": (_MORE_OVERLAP, _MORE_FRAMES),
    }
)


def step_of(cause: Cause, codes: Sequence[str] | None) -> str:
    """The stage at which a LiDAR was left out, with what failed there.

    Args:
        codes: of the reasons against the decisive comparison; None where there was none.
    """
    if codes is None:
        return _STEPS_WITHOUT_PAIR.get(cause, "coarse: no pose was found with any other LiDAR")
    return "fine: the verdict on the registered pair" if codes else "merge: joining the groups"


def cause_of_codes(codes: Sequence[str]) -> Cause:
    """The cause that a verdict's reasons stand for."""
    return next((cause for code, cause in _BY_CODE if code in codes), "unknown")


def by_weight(codes: Iterable[str]) -> list[str]:
    """The codes of a verdict's reasons, the one that its cause is named after first."""
    order = {code: place for place, (code, _) in enumerate(_BY_CODE)}
    return sorted(codes, key=lambda code: order.get(code, len(order)))
