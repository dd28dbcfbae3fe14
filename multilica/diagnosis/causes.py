# SPDX-License-Identifier: Apache-2.0
"""Texts for each cause: description, advice, stage."""

from collections.abc import Iterable, Mapping, Sequence

from multilica.diagnosis.explanation import Cause

_REASONS: Mapping[str, tuple[Cause, str]] = {
    "against_prior": ("against_prior", "contradicts the prior"),
    "too_little_evidence": ("no_overlap", "too little evidence"),
    "empty_space_violated": ("contradiction", "points in empty space"),
    "cycle_contradicted": ("two_places", "another pair contradicts it"),
    "ambiguous": ("ambiguous", "another pose not ruled out"),
    "not_observable": ("not_observable", "not constrained in one direction"),
    "structure_unexplained": ("unexplained", "walls and objects unexplained"),
    "too_far_apart": ("unexplained", "LiDARs too far apart"),
    "imprecise": ("uncertain", "sigma above the limit"),
    "low_fitness": ("low_fitness", "low fitness"),
}
"""Cause and short label per reason code; the first of these codes in a verdict names the cause."""

REASON_WORDS: Mapping[str, str] = {code: words for code, (_, words) in _REASONS.items()}

WORDS: Mapping[Cause, str] = {
    "dead_sensor": "it returned nothing (dead sensor or empty topic)",
    "no_returns_in_range": "all its returns are out of range, too near or too far",
    "dirty_sensor": "its window is dirty or covered",
    "moving_vehicle": "the vehicle moved while the snapshot was taken",
    "unfit_input": "the snapshot has too little data to calibrate",
    "no_overlap": "it shares too few surfaces with the others (no overlap)",
    "contradiction": "every pose found puts surfaces into space that beams proved empty",
    "ambiguous": "the scene looks the same from two places (a symmetric scene)",
    "not_observable": "the scene does not constrain it in one direction",
    "uncertain": "one pose fits, but its sigma is above the limit",
    "unexplained": "its best pose is too unlikely: surfaces do not match, or it is far off (a chance agreement)",
    "low_fitness": "too few of its points lie near those of other LiDARs",
    "against_prior": "its pose contradicts the prior, and one of the two may be turned the wrong way",
    "two_places": "two accepted pairs put it at different places",
    "not_in_rig": "it fits another LiDAR, but not the merged rig",
    "not_joined": "it is connected only to LiDARs that are not placed",
    "disputed": "the snapshots contradict each other, without a majority",
    "stopped_early": "the run was set to stop before LiDARs are placed",
    "out_of_time": "the time limit (--max-time) ended the search before all of its pairs were searched",
    "unfinished": "the run ended before it was placed",
    "unknown": "no registration with another LiDAR was accepted",
}

_MORE_OVERLAP = "a scene with structure in the common field of view, or another LiDAR that overlaps both"
_OTHER_PLACE = "another scene, with walls, poles or parked cars at uneven distances around the vehicle"
_TOGETHER = "a second snapshot from another place, calibrated together with this one"
PRIOR_ADVICE = "the pose from a drawing or an earlier calibration as one more hypothesis (--prior)"
"""A prior adds a pose that the descriptors miss; it does not decide between poses that fit equally well."""
_MORE_FRAMES = "more frames (--frames), so that sparse surfaces are seen"

_STEPS_WITHOUT_PAIR: Mapping[Cause, str] = {
    "dead_sensor": "preprocess: no returns",
    "no_returns_in_range": "preprocess: no return was kept",
    "dirty_sensor": "preprocess: part of the field of view is covered",
    "out_of_time": "correspond: its pairs were not searched",
    **dict.fromkeys(("disputed", "not_joined", "unknown"), "joint: comparison of the snapshots"),
}

ADVICE: Mapping[Cause, tuple[str, ...]] = {
    "dead_sensor": ("check power, network and driver of the LiDAR; `multilica inspect` shows if it sends points",),
    "no_returns_in_range": ("check preprocess.min_range_m and preprocess.max_range_m, and remove any cover",),
    "dirty_sensor": ("clean the window, take off covers, and record again",),
    "moving_vehicle": (
        "record while the vehicle stands still, or choose another window with --start or --window auto",
    ),
    "unfit_input": ("a recording with at least two LiDARs that have returns, as `multilica inspect` shows",),
    "no_overlap": (_MORE_OVERLAP, _MORE_FRAMES, PRIOR_ADVICE),
    "contradiction": (
        "a scene where nothing moves",
        "see the red points of the pair in the recording",
        _MORE_OVERLAP,
        PRIOR_ADVICE,
    ),
    "ambiguous": (_OTHER_PLACE, _TOGETHER),
    "not_observable": (_OTHER_PLACE, _MORE_OVERLAP, _MORE_FRAMES),
    "uncertain": (
        _MORE_OVERLAP,
        _OTHER_PLACE,
        _TOGETHER,
        "a higher limit, if the task allows this sigma (--max-sigma MM,DEG)",
    ),
    "unexplained": (_MORE_OVERLAP, _OTHER_PLACE, PRIOR_ADVICE),
    "low_fitness": (_MORE_OVERLAP, "--preset default, which checks more than the fitness"),
    "against_prior": ("check how the LiDAR is mounted, and the sign of its angles in the prior",),
    "two_places": (_OTHER_PLACE, _TOGETHER, _MORE_OVERLAP),
    "not_in_rig": (_MORE_OVERLAP, _OTHER_PLACE, _TOGETHER),
    "not_joined": (_MORE_OVERLAP, "another target (--target) among the LiDARs that it fits"),
    "disputed": (
        "one more snapshot, from another place, for a majority",
        "check the result of each snapshot, in the subdirectory with its name",
    ),
    "stopped_early": ("run again without --until",),
    "out_of_time": ("more time (--max-time), more --workers, or fewer --frames",),
    "unfinished": ("run again", "see every finished stage in the recording"),
    "unknown": (_MORE_OVERLAP, _MORE_FRAMES),
}


def step_of(cause: Cause, codes: Sequence[str] | None) -> str:
    """Return the stage at which a LiDAR was left out, with the failure; the codes are None without pairs."""
    if codes is None:
        return _STEPS_WITHOUT_PAIR.get(cause, "coarse: no pose was found against any other LiDAR")
    return "fine: the pair was registered but not accepted" if codes else "merge: the group was not merged"


def cause_of_codes(codes: Sequence[str]) -> Cause:
    """Return the cause that the codes of a verdict indicate."""
    return next((cause for code, (cause, _) in _REASONS.items() if code in codes), "unknown")


def by_weight(codes: Iterable[str]) -> list[str]:
    """Sort the codes of a verdict, the one that names the cause first."""
    order = {code: place for place, code in enumerate(_REASONS)}
    return sorted(codes, key=lambda code: order.get(code, len(order)))
