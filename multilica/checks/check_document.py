# SPDX-License-Identifier: Apache-2.0
"""The output of `multilica check --json` and `multilica verify --json`."""

from collections.abc import Mapping, Sequence
from typing import Literal

from pydantic import Field

from multilica.checks.comparison import CheckVerdict, LidarCheck, RigCheck, joint_verdict
from multilica.results.document.values import Entry, Number, Vector3


class LidarCheckEntry(Entry):
    """One LiDAR against its reference; found - reference pose along the axes of the root, null where not known."""

    verdict: CheckVerdict
    reason: str
    distance_m: Number
    angle_deg: Number
    translation_m: Vector3 | None
    rotation_rad: Vector3 | None
    sigma_m: Number
    sigma_deg: Number
    max_translation_m: float
    max_rotation_deg: float


class RigCheckEntry(Entry):
    """One run or recording against the reference."""

    name: str
    verdict: CheckVerdict
    sentence: str
    root: str
    moved: tuple[str, ...]
    lidars: Mapping[str, LidarCheckEntry]
    notes: tuple[str, ...]


class CheckDocument(Entry):
    """All runs and recordings of a check."""

    schema_: Literal["multilica/check/1"] = Field("multilica/check/1", alias="schema")
    verdict: CheckVerdict
    reference: str
    rigs: tuple[RigCheckEntry, ...]


def check_document(rigs: Sequence[RigCheck], reference: str) -> CheckDocument:
    """Convert checks to the document."""
    entries = tuple(
        RigCheckEntry.of(rig, lidars={each.lidar: _entry(each) for each in rig.lidars}, moved=rig.moved) for rig in rigs
    )
    return CheckDocument(verdict=joint_verdict([rig.verdict for rig in rigs]), reference=reference, rigs=entries)


def _entry(check: LidarCheck) -> LidarCheckEntry:
    error = check.error
    return LidarCheckEntry.of(
        check,
        distance_m=None if error is None else error.distance_m,
        angle_deg=None if error is None else error.angle_deg,
        translation_m=None if error is None else error.translation_m,
        rotation_rad=None if error is None else error.rotation_rad,
        max_translation_m=check.tolerance.translation_m,
        max_rotation_deg=check.tolerance.rotation_deg,
    )
