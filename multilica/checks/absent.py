# SPDX-License-Identifier: Apache-2.0
"""LiDARs of a reference that a recording lacks."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from multilica.checks.comparison import LidarCheck, RigCheck
from multilica.checks.reference import poses_of
from multilica.checks.tolerances import RigTolerances
from multilica.errors import listed
from multilica.runs.run_documents import is_run


def absent_lidars(path: Path, frame_ids: Mapping[str, str]) -> list[str]:
    """Return the LiDARs of a reference that a recording lacks: of a run, or of a TOML table of poses.

    Frames in files of other formats may be anything.

    Args:
        path: a reference that `read_reference` takes.
        frame_ids: of the LiDARs of the recording, by name.
    """
    if not is_run(path) and path.suffix != ".toml":
        return []
    found = poses_of(path)
    lidars = found.members if is_run(path) else frozenset(found.T_target_source)
    return sorted(lidars - {*frame_ids, *frame_ids.values()})


def with_absent(check: RigCheck, absent: Sequence[str], tolerances: RigTolerances, *, chosen: bool) -> RigCheck:
    """Add the LiDARs of the reference that the recording lacks: nothing tells where they are.

    Args:
        chosen: the user named the topics, so that the others are left out on purpose: a note says so.
    """
    if not absent:
        return check
    if chosen:
        note = f"the reference has {listed(absent)}, which the chosen topics leave out"
        return check.model_copy(update={"notes": (*check.notes, note)})
    missing = [
        LidarCheck(
            lidar=name,
            verdict="undecided",
            reason="nothing to compare: no scan of that LiDAR was read",
            max_translation_m=tolerances.of(name).translation_m,
            max_rotation_deg=tolerances.of(name).rotation_deg,
        )
        for name in absent
    ]
    return check.model_copy(update={"lidars": (*check.lidars, *missing)})
