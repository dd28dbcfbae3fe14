# SPDX-License-Identifier: Apache-2.0
"""Types of an explanation, with the texts for each cause."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

_MORE_OVERLAP = "a scene with structure in the common field of view, or another LiDAR that overlaps both"
_OTHER_PLACE = "another scene, with walls, poles or parked cars at uneven distances around the vehicle"
_TOGETHER = "a second snapshot from another place, calibrated together with this one"
PRIOR_ADVICE = "the pose from a drawing or an earlier calibration as one more hypothesis (--prior)"
"""A prior adds a pose that the descriptors miss; it does not decide between poses that fit equally well."""
_MORE_FRAMES = "more frames (--frames), so that sparse surfaces are seen"

CAUSES: Mapping[str, tuple[str, ...]] = {
    "dead_sensor": (
        "it returned nothing (dead sensor or empty topic)",
        "check power, network and driver of the LiDAR; `multilica inspect` shows if it sends points",
    ),
    "no_returns_in_range": (
        "all its returns are out of range, too near or too far",
        "check preprocess.min_range_m and preprocess.max_range_m, and remove any cover",
    ),
    "dirty_sensor": ("its window is dirty or covered", "clean the window, take off covers, and record again"),
    "moving_vehicle": (
        "the vehicle moved while the snapshot was taken",
        "record while the vehicle stands still, or choose another window with --start or --window auto",
    ),
    "unfit_input": (
        "the snapshot has too little data to calibrate",
        "a recording with at least two LiDARs that have returns, as `multilica inspect` shows",
    ),
    "no_overlap": (
        "it shares too few surfaces with the others (no overlap)",
        _MORE_OVERLAP,
        _MORE_FRAMES,
        PRIOR_ADVICE,
    ),
    "contradiction": (
        "every pose found puts surfaces into space that beams proved empty",
        "a scene where nothing moves",
        "see the red points of the pair in the recording",
        _MORE_OVERLAP,
        PRIOR_ADVICE,
    ),
    "ambiguous": ("the scene looks the same from two places (a symmetric scene)", _OTHER_PLACE, _TOGETHER),
    "not_observable": ("the scene does not constrain it in one direction", _OTHER_PLACE, _MORE_OVERLAP, _MORE_FRAMES),
    "uncertain": (
        "one pose fits, but its sigma is above the limit",
        _MORE_OVERLAP,
        _OTHER_PLACE,
        _TOGETHER,
        "a higher limit, if the task allows this sigma (--max-sigma MM,DEG)",
    ),
    "held_by_movable": (
        "only cars, people and the like hold it in one direction, and they moved or may have moved",
        "several frames (--frames 10), in which moving points show and are left out",
        "another scene, with walls or poles at uneven distances around the vehicle",
        _TOGETHER,
    ),
    "by_motion": (
        "only its motion between the stops tells its pose",
        "a stop where it sees what another LiDAR saw at another stop",
        "turn by 60 degrees or more between two stops",
    ),
    "unexplained": (
        "its best pose is too unlikely: surfaces do not match, or it is far off (a chance agreement)",
        _MORE_OVERLAP,
        _OTHER_PLACE,
        PRIOR_ADVICE,
    ),
    "low_fitness": (
        "too few of its points lie near those of other LiDARs",
        _MORE_OVERLAP,
        "--preset default, which checks more than the fitness",
    ),
    "against_prior": (
        "its pose contradicts the prior, and one of the two may be turned the wrong way",
        "check how the LiDAR is mounted, and the sign of its angles in the prior",
    ),
    "two_places": ("two accepted pairs put it at different places", _OTHER_PLACE, _TOGETHER, _MORE_OVERLAP),
    "not_in_rig": ("it fits another LiDAR, but not the merged rig", _MORE_OVERLAP, _OTHER_PLACE, _TOGETHER),
    "not_joined": (
        "it is connected only to LiDARs that are not placed",
        _MORE_OVERLAP,
        "another target (--target) among the LiDARs that it fits",
    ),
    "disputed": (
        "the snapshots contradict each other, without a majority",
        "one more snapshot, from another place, for a majority",
        "check the result of each snapshot, in the subdirectory with its name",
    ),
    "stopped_early": ("the run was set to stop before LiDARs are placed", "run again without --until"),
    "out_of_time": (
        "the time limit (--max-time) ended the search before all of its pairs were searched",
        "more time (--max-time), more --workers, or fewer --frames",
    ),
    "unfinished": ("the run ended before it was placed", "run again", "see every finished stage in the recording"),
    "unknown": ("no registration with another LiDAR was accepted", _MORE_OVERLAP, _MORE_FRAMES),
}
"""Description of each cause, then what would help, the most promising first."""

_REASONS: Mapping[str, tuple[str, str]] = {
    "against_prior": ("against_prior", "contradicts the prior"),
    "too_little_evidence": ("no_overlap", "too little evidence"),
    "empty_space_violated": ("contradiction", "points in empty space"),
    "cycle_contradicted": ("two_places", "another pair contradicts it"),
    "ambiguous": ("ambiguous", "another pose not ruled out"),
    "held_by_repetition": ("ambiguous", "the scene repeats"),
    "not_observable": ("not_observable", "not constrained in one direction"),
    "structure_unexplained": ("unexplained", "walls and objects unexplained"),
    "held_by_movable": ("held_by_movable", "held by objects that can move"),
    "too_far_apart": ("unexplained", "LiDARs too far apart"),
    "imprecise": ("uncertain", "sigma above the limit"),
    "sigma_unknown": ("no_overlap", "too few surfaces to tell sigma"),
    "out_of_time": ("out_of_time", "the time was over"),
    "low_fitness": ("low_fitness", "low fitness"),
}
"""Cause and short label per reason code; the first of these codes in a verdict names the cause."""

REASON_WORDS: Mapping[str, str] = {code: words for code, (_, words) in _REASONS.items()}
_STEPS_WITHOUT_PAIR: Mapping[str, str] = {
    "dead_sensor": "preprocess: no returns",
    "no_returns_in_range": "preprocess: no return was kept",
    "dirty_sensor": "preprocess: part of the field of view is covered",
    "out_of_time": "correspond: its pairs were not searched",
    **dict.fromkeys(("disputed", "not_joined", "unknown"), "joint: comparison of the snapshots"),
}


def in_words(names: Iterable[str]) -> str:
    """Return one or more names for a sentence."""
    *others, last = names
    return f"{', '.join(others)} and {last}" if others else last


def step_of(cause: str, codes: Sequence[str] | None) -> str:
    """Return the stage at which a LiDAR was left out, with the failure; the codes are None without pairs."""
    if codes is None:
        return _STEPS_WITHOUT_PAIR.get(cause, "coarse: no pose was found against any other LiDAR")
    return "fine: the pair was registered but not accepted" if codes else "merge: the group was not merged"


def cause_of_codes(codes: Sequence[str]) -> str:
    """Return the cause that the codes of a verdict indicate."""
    return next((cause for code, (cause, _) in _REASONS.items() if code in codes), "unknown")


def by_weight(codes: Iterable[str]) -> list[str]:
    """Sort the codes of a verdict, the one that names the cause first."""
    order = {code: place for place, code in enumerate(_REASONS)}
    return sorted(codes, key=lambda code: order.get(code, len(order)))


@dataclass(frozen=True, slots=True)
class DecisivePair:
    """The registered pair that decided whether a LiDAR is placed, with the codes of the reasons against it, if any."""

    target: str
    source: str
    codes: tuple[str, ...]
    sentence: str

    @property
    def key(self) -> tuple[str, str]:
        """Target and source."""
        return self.target, self.source


@dataclass(frozen=True, slots=True)
class Placed:
    """A placed LiDAR other than the target; each sigma is that of the weakest direction, None without a covariance."""

    lidar: str
    sigma_m: float | None
    sigma_deg: float | None
    sentence: str


@dataclass(frozen=True, slots=True)
class Missing:
    """A LiDAR that was not placed.

    Args:
        headline: the LiDAR with its cause, in one sentence.
        step: the stage at which it was left out, with the failure.
        decisive: the pair that was nearest to placing it; None without pairs.
        elsewhere: the accepted pair that puts it at another place; None unless two accepted pairs contradict.
        next_best: the next pose of the decisive pair, or the next pair; empty if there is none.
        by_snapshot: reason per snapshot, of several; the decisive pair is that of one of them.
        by_stop: stops of a drive that see it linked with others; else empty.
        advice: what would help, the most promising first.
    """

    lidar: str
    cause: str
    headline: str
    step: str
    decisive: DecisivePair | None = None
    elsewhere: DecisivePair | None = None
    next_best: str = ""
    by_snapshot: str = ""
    by_stop: str = ""
    advice: tuple[str, ...] = ()

    @property
    def details(self) -> tuple[str, ...]:
        """Sentences below the headline."""
        decisive = "" if self.decisive is None else self.decisive.sentence
        known = {
            "Decisive": decisive,
            "Next best": self.next_best,
            "By snapshot": self.by_snapshot,
            "By stop": self.by_stop,
        }
        texts = (f"{name}: {text}" for name, text in known.items() if text)
        return (f"At stage {self.step}.", *texts, *(f"What helps: {advice}." for advice in self.advice))


@dataclass(frozen=True, slots=True)
class Uncertain:
    """A LiDAR with one pose, uncontradicted, whose standard deviation is above the limit.

    Args:
        headline: the LiDAR with its figure, direction and limit, in one sentence.
        direction: the one that exceeds its limit, such as "mostly along x of top".
        sigma_m, sigma_deg: standard deviations of position and rotation in their weakest directions.
        max_sigma_m, max_sigma_deg: the limits.
        advice: what would help, the most promising first.
    """

    lidar: str
    headline: str
    direction: str
    sigma_m: float
    sigma_deg: float
    max_sigma_m: float
    max_sigma_deg: float
    advice: tuple[str, ...]
    cause: str = "uncertain"

    @property
    def details(self) -> tuple[str, ...]:
        """Sentences below the headline."""
        return tuple(f"What helps: {advice}." for advice in self.advice)


@dataclass(frozen=True, slots=True)
class Explanation:
    """The outcome of a run for people.

    Args:
        headline: the outcome in one sentence, with the causes; the first thing to show.
        cause: of the whole run, if it was refused or cut off before any LiDAR could be placed; else None.
        input: what was calibrated, in one sentence.
        known: what a refused or cut off run had found by then.
        advice: what would help the whole run.
        warnings: doubts that did not stop the run.
    """

    headline: str
    input: str
    placed: tuple[Placed, ...] = ()
    missing: tuple[Missing, ...] = ()
    uncertain: tuple[Uncertain, ...] = ()
    cause: str | None = None
    known: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def unclear(self) -> tuple[Missing | Uncertain, ...]:
        """The LiDARs that are not placed, then the uncertain ones."""
        return (*self.missing, *self.uncertain)

    @property
    def lines(self) -> tuple[str, ...]:
        """The facts beside the table of placed LiDARs as plain text, a sentence per line, details indented."""
        return (self.headline, self.input, *self.known, *self.findings[1:])

    @property
    def findings(self) -> tuple[str, ...]:
        """The same for a run whose input is known: headline, missing and uncertain LiDARs, warnings."""
        lines = [self.headline]
        for each in self.unclear:
            lines += [each.headline, *(f"  {detail}" for detail in each.details)]
        lines += [f"What helps: {advice}." for advice in self.advice]
        return (*lines, *(f"Warning: {warning}" for warning in self.warnings))
