# SPDX-License-Identifier: Apache-2.0
"""Comparison of a rig with its reference: which LiDARs are where they should be, and which have moved."""

from collections.abc import Collection, Mapping, Sequence
from typing import Literal

import numpy as np
from pydantic import Field, model_serializer
from scipy.special import chdtrc

from multilica.checks.tolerances import RigTolerances, Tolerance
from multilica.errors import UsageError
from multilica.extrinsics import Extrinsics
from multilica.geometry import FloatArray, RigidTransform
from multilica.results import Knock, LidarPlacement
from multilica.results.placements import LEAST_PROBABILITY
from multilica.results.values import Entry, Number, Vector3
from multilica.runs.pose_error import PoseError
from multilica.runs.run_documents import SavedRun

CheckVerdict = Literal["within", "outside", "undecided"]

_FREEDOM = 3
"""Directions of a translation, and of a rotation."""


class LidarCheck(Entry):
    """One LiDAR against its reference; in JSON an entry under its name.

    Args:
        reason: of the verdict, for people.
        distance_m, angle_deg, translation_m, rotation_rad: found - reference pose, along the axes of the root; None
            where the LiDAR has no pose or no reference.
        sigma_m, sigma_deg: largest standard deviation of the difference, if both poses have the same truth: of the
            found pose and, where it is known, of the reference; None where that of the found pose is not known.
        reference_sigma_m, reference_sigma_deg: the reference's part of it; None where it is not known.
        translation_probability, rotation_probability: of as large a difference of a LiDAR that has not moved, by the
            covariance of the difference: chi squared with 3 degrees of freedom each.
        max_translation_m, max_rotation_deg: the tolerance: that of the LiDAR, or what the root has of its own if that
            is smaller and no majority agrees with the root.
    """

    lidar: str = Field(exclude=True)
    verdict: CheckVerdict
    reason: str
    distance_m: Number = None
    angle_deg: Number = None
    translation_m: Vector3 | None = None
    rotation_rad: Vector3 | None = None
    sigma_m: Number = None
    sigma_deg: Number = None
    reference_sigma_m: Number = None
    reference_sigma_deg: Number = None
    translation_probability: Number = None
    rotation_probability: Number = None
    max_translation_m: float
    max_rotation_deg: float

    @property
    def elsewhere(self) -> bool:
        """True if another stop of the drive finds it within, and this one did not measure it."""
        return self.verdict == "within" and self.distance_m is None

    @property
    def share(self) -> float | None:
        """The difference as a share of the tolerance, in translation or rotation, whichever is larger."""
        if self.distance_m is None or self.angle_deg is None:
            return None
        return max(self.distance_m / self.max_translation_m, self.angle_deg / self.max_rotation_deg)


class RigCheck(Entry):
    """A run or recording against its reference: LiDARs, by name, compared to the root, which agrees by definition."""

    name: str
    root: str
    lidars: tuple[LidarCheck, ...]
    notes: tuple[str, ...] = ()

    @property
    def verdict(self) -> CheckVerdict:
        """``outside`` if any LiDAR is, else ``undecided`` if any is."""
        return joint_verdict([each.verdict for each in self.lidars])

    @property
    def moved(self) -> tuple[str, ...]:
        """The LiDARs outside."""
        return tuple(each.lidar for each in self.lidars if each.verdict == "outside")

    @property
    def sentence(self) -> str:
        """The outcome, for people."""
        undecided = [each.lidar for each in self.lidars if each.verdict == "undecided"]
        elsewhere = [each.lidar for each in self.lidars if each.elsewhere]
        parts = []
        if self.moved:
            parts.append(f"{_and(self.moved)} {'is' if len(self.moved) == 1 else 'are'} outside")
        if undecided:
            parts.append(f"{_and(undecided)} cannot be decided")
        if elsewhere:
            parts.append(f"{_and(elsewhere)} {'was' if len(elsewhere) == 1 else 'were'} not measured here")
        if not parts:
            return f"All {len(self.lidars) + 1} LiDARs agree with the reference."
        return f"{'; '.join(parts)}."

    @model_serializer
    def _serialize(self) -> dict[str, object]:
        lidars = {each.lidar: each for each in self.lidars}
        names = ("name", "verdict", "sentence", "root", "moved")
        return {name: getattr(self, name) for name in names} | {"lidars": lidars, "notes": self.notes}


class CheckDocument(Entry):
    """The output of `multilica check --json` and `multilica verify --json`: all runs and recordings of a check."""

    schema_: Literal["multilica/check/1"] = Field("multilica/check/1", alias="schema")
    verdict: CheckVerdict
    reference: str
    rigs: tuple[RigCheck, ...]

    @property
    def sentence(self) -> str:
        """The outcome of all, for people."""
        told = [f"{rig.name}: {rig.sentence}" for rig in self.rigs if rig.verdict == self.verdict]
        return "All LiDARs agree with the reference." if self.verdict == "within" else " ".join(told)


def check_document(rigs: Sequence[RigCheck], reference: str) -> CheckDocument:
    """Return the document of several checks."""
    verdict = joint_verdict([rig.verdict for rig in rigs])
    return CheckDocument(verdict=verdict, reference=reference, rigs=tuple(rigs))


def joint_verdict(verdicts: Sequence[CheckVerdict]) -> CheckVerdict:
    """Return the verdict over several."""
    return "outside" if "outside" in verdicts else "undecided" if "undecided" in verdicts else "within"


def check_rig(found: SavedRun, reference: Extrinsics, tolerances: RigTolerances) -> RigCheck:
    """Compare the poses of a run with a reference.

    The LiDARs are compared to that one with which most others agree, so that a single moved LiDAR is named even if it
    is the target. A pair agrees within the smaller of its two tolerances. A LiDAR that moved later than the stops that
    its pose is from is judged by where it is now.

    A difference counts only if the covariances of found pose and reference do not explain it: their sum, as of two
    scenes that share no errors. A standard deviation above the tolerance decides nothing.

    Raises:
        UsageError: run and reference have fewer than two LiDARs in common, or a tolerance is for none of them.
    """
    names = {each.lidar for each in found.placements}
    common = names & reference.members
    _require_names(found, reference, sorted(common), tolerances)
    compared = sorted((each for each in found.placements if each.lidar in common), key=lambda each: each.lidar)
    placed = {each.lidar: each for each in compared if each.T_target_source is not None}
    undone = {knock.lidar: knock for knock in found.knocks if knock.is_undone}
    root, limits, notes = _root(found.target, placed, reference, tolerances, undone)
    checks = tuple(
        _moved_since(
            _check(
                each, placed.get(root), found.target, reference, limits.get(each.lidar) or tolerances.of(each.lidar)
            ),
            undone.get(each.lidar) or undone.get(root),
        )
        for each in compared
        if each.lidar != root
    )
    notes += [knock.text for knock in found.knocks]
    knocked = {knock.lidar for knock in found.knocks}
    notes += [f"{each.name}: {each.text}" for each in found.snapshots if {*each.outliers} - knocked]
    notes += _about_covariances(found, root, placed, reference)
    if extra := sorted(names - common):
        notes.append(f"the reference has no pose of {_and(extra)}")
    if absent := sorted(reference.members - common - {reference.target}):
        notes.append(f"{found.name} has no LiDAR {_and(absent)}")
    return RigCheck(name=found.name, root=root, lidars=checks, notes=tuple(notes))


def _require_names(found: SavedRun, reference: Extrinsics, common: Sequence[str], tolerances: RigTolerances) -> None:
    names = sorted(placement.lidar for placement in found.placements)
    if len(common) < 2:
        raise UsageError(
            f"{found.name} ({', '.join(names)}) and the reference ({', '.join(sorted(reference.members))}) have "
            f"{len(common)} LiDAR(s) in common; a check needs two or more of the same name."
        )
    if unknown := sorted({*tolerances.lidars} - {*names} - reference.members):
        raise UsageError(f"There is a tolerance for '{unknown[0]}'; expected one of {', '.join(names)}.")


def _root(
    target: str,
    placed: dict[str, LidarPlacement],
    reference: Extrinsics,
    tolerances: RigTolerances,
    moved: Collection[str] = (),
) -> tuple[str, dict[str, Tolerance], list[str]]:
    """Choose the LiDAR with which most agree: of equals one that has not moved, without a tolerance, or the target.

    Returns:
        The root, the tolerance of each other placed LiDAR beside it, and notes.
    """
    if len(placed) < 2:
        names = placed or reference.members
        return (target if target in names else min(names)), {}, []
    errors = {
        (root, name): PoseError.between(*_poses(placed[root], placement, reference))
        for root in placed
        for name, placement in placed.items()
    }
    agreeing = {
        root: frozenset(
            name for name in placed if name == root or tolerances.smaller(name, root).holds(errors[root, name])
        )
        for root in sorted(placed)
    }
    root = max(
        agreeing,
        key=lambda name: (len(agreeing[name]), name not in moved, not tolerances.has_own(name), name == target),
    )
    confirmed = 2 * len(agreeing[root]) > len(placed)  # else the root may be the one that is off by its own tolerance
    limits = {
        name: tolerances.of(name) if confirmed else tolerances.beside(name, root) for name in placed if name != root
    }
    others = [name for name in sorted(limits) if not limits[name].holds(errors[root, name])]
    rival = next((name for name in others if len(agreeing[name]) == len(agreeing[root])), None)
    if rival is None:
        return root, limits, []
    return root, limits, [f"equally many LiDARs agree with {root} and with {rival}, so the one that moved is unknown"]


def _poses(
    root: LidarPlacement, placement: LidarPlacement, reference: Extrinsics
) -> tuple[RigidTransform, RigidTransform]:
    """Return the found and the reference pose of a LiDAR in the frame of the root."""
    assert root.T_target_source is not None and placement.T_target_source is not None  # noqa: S101, PT018
    found = root.T_target_source.inverse() @ placement.T_target_source
    return found, reference.between(root.lidar, placement.lidar)


def _about_covariances(
    found: SavedRun, root: str, placed: Mapping[str, LidarPlacement], reference: Extrinsics
) -> list[str]:
    """Say of which LiDARs the reference has no covariance though the run has one."""
    known = [
        name
        for name in placed
        if name != root and relative_covariance(placed[root], placed[name], found.target) is not None
    ]
    without = [name for name in known if reference.covariance_between(root, name) is None]
    if not without:
        return []
    of_some = f" of {_and(without)}" if len(without) < len(known) else ""
    return [f"the reference has no covariance{of_some}, so its own errors do not count"]


def _check(
    placement: LidarPlacement, root: LidarPlacement | None, target: str, reference: Extrinsics, tolerance: Tolerance
) -> LidarCheck:
    limits = {"max_translation_m": tolerance.translation_m, "max_rotation_deg": tolerance.rotation_deg}
    if placement.T_target_source is None or root is None or root.T_target_source is None:
        reason = f"not placed: {placement.reason}"
        return LidarCheck(lidar=placement.lidar, verdict="undecided", reason=reason, **limits)
    error = PoseError.between(*_poses(root, placement, reference))
    found, known = (
        relative_covariance(root, placement, target),
        reference.covariance_between(root.lidar, placement.lidar),
    )
    both = found if found is None or known is None else found + known
    probabilities = _probabilities(error, both)
    sigmas, reference_sigmas = _largest_sigmas(both), _largest_sigmas(known)
    verdicts = [
        _decide(error.distance_m, tolerance.translation_m, sigmas[0], probabilities[0], 1000.0, "mm"),
        _decide(error.angle_deg, tolerance.rotation_deg, sigmas[1], probabilities[1], 1.0, "deg"),
    ]
    verdict = joint_verdict([one for one, _ in verdicts])
    return LidarCheck.of(
        error,
        lidar=placement.lidar,
        verdict=verdict,
        reason="; ".join(text for one, text in verdicts if one == verdict),
        sigma_m=sigmas[0],
        sigma_deg=sigmas[1],
        reference_sigma_m=reference_sigmas[0],
        reference_sigma_deg=reference_sigmas[1],
        translation_probability=probabilities[0],
        rotation_probability=probabilities[1],
        **limits,
    )


def _moved_since(check: LidarCheck, knock: Knock | None) -> LidarCheck:
    """Return the check of a LiDAR by where it is now, if a knock came after the stops that its pose is from.

    The direction of a knock is not known: a LiDAR that was off by d and moved by k is off by ``|d - k|`` to d + k.
    """
    if knock is None or check.distance_m is None or check.angle_deg is None:
        return check
    now = (
        (abs(check.distance_m - knock.distance_m), check.distance_m + knock.distance_m, check.max_translation_m),
        (abs(check.angle_deg - knock.angle_deg), check.angle_deg + knock.angle_deg, check.max_rotation_deg),
    )
    verdict: CheckVerdict = "undecided"
    if any(least > limit for least, _, limit in now):
        verdict = "outside"
    elif check.verdict == "within" and all(most <= limit for _, most, limit in now):
        verdict = "within"
    return check.model_copy(update={"verdict": verdict, "reason": f"{knock.motion}; before: {check.reason}"})


def _largest_sigmas(covariance: FloatArray | None) -> tuple[float | None, float | None]:
    """Return the standard deviations of position (m) and rotation (deg) in their weakest directions."""
    if covariance is None:
        return None, None
    of_rotation, of_translation = (np.linalg.eigvalsh(each)[-1] for each in (covariance[:3, :3], covariance[3:, 3:]))
    return float(np.sqrt(of_translation)), float(np.rad2deg(np.sqrt(of_rotation)))


def _probabilities(error: PoseError, covariance: FloatArray | None) -> tuple[float | None, float | None]:
    """Return how often a LiDAR that has not moved differs as much, in translation and in rotation."""
    if covariance is None:
        return None, None
    parts = ((error.translation_m, covariance[3:, 3:]), (error.rotation_rad, covariance[:3, :3]))
    translation, rotation = (float(chdtrc(_FREEDOM, off @ np.linalg.solve(known, off))) for off, known in parts)
    return translation, rotation


def _decide(
    off: float, limit: float, sigma: float | None, probability: float | None, scale: float, unit: str
) -> tuple[CheckVerdict, str]:
    """Return the verdict on one of translation and rotation, with its reason."""
    size, most, known = (f"{_digits(scale * value)} {unit}" for value in (off, limit, sigma or 0.0))
    if off > limit:
        if probability is None or probability < LEAST_PROBABILITY:
            return "outside", f"{size} is above {most}"
        chance = f"{100.0 * probability:.2g} % of unmoved LiDARs differ as much (sigma {known})"
        return "undecided", f"{size} is above {most}, but {chance}"
    if sigma is not None and sigma > limit:
        return "undecided", f"its sigma of {known} is above the tolerance of {most}"
    return "within", f"{size} of {most}"


def _digits(value: float) -> str:
    """Return a figure with three digits, but no power of ten."""
    return f"{value:.0f}" if value >= 100.0 else f"{round(value, 4):.3g}"


def relative_covariance(root: LidarPlacement, placement: LidarPlacement, target: str) -> FloatArray | None:
    """Return the (6, 6) covariance of a pose in the frame of the root, as if both shared no errors."""
    both = [(each.lidar, each.T_target_source, each.covariance) for each in (root, placement)]
    poses = {name: pose for name, pose, _ in both if pose is not None}
    covariances = {name: covariance for name, _, covariance in both if covariance is not None}
    return Extrinsics(target, poses, covariances=covariances).covariance_between(root.lidar, placement.lidar)


def _and(names: Sequence[str]) -> str:
    return " and ".join([part for part in (", ".join(names[:-1]), names[-1]) if part])
