# SPDX-License-Identifier: Apache-2.0
"""A picture of a saved run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from multilica.errors import SourceNotFoundError, UsageError, ViewerError
from multilica.fleet.run_documents import read_run_document
from multilica.fleet.run_report import contents_of_run
from multilica.geometry import RigidTransform
from multilica.sinks.report.figures import rig_picture
from multilica.sinks.report.level import LEVEL, level_pose
from multilica.sinks.rerun_viewer import viewer_picture

__all__ = ["Renderer", "RunPicture", "picture_of_run", "recording_of_run"]

Renderer = Literal["auto", "rerun", "own"]
_SIDE_PX = (64, 8192)


@dataclass(frozen=True, slots=True, eq=False)
class RunPicture:
    """A picture with who drew it.

    Args:
        png: the file.
        drawn_by: in words; with the reason where the viewer was wanted and could not.
    """

    png: bytes
    drawn_by: str


def recording_of_run(path: Path) -> Path:
    """The recording of a run directory, whole or cut off, or the recording itself.

    Raises:
        SourceNotFoundError: nothing there, or no recording.
    """
    if path.suffix == ".rrd" and path.is_file():
        return path
    recording = read_run_document(path).recording
    if recording is None:
        raise SourceNotFoundError(f"{path} has no recording beside it, which `multilica calibrate` writes.")
    return recording


def picture_of_run(path: Path, size_px: tuple[int, int], renderer: Renderer = "auto") -> RunPicture:
    """Draw a run without a screen.

    Args:
        path: a run directory or a recording.
        size_px: width and height.
        renderer: `rerun` for what Rerun's viewer shows first, `own` for the clouds from above as the report draws
            them, `auto` for the first of the two that works.

    Raises:
        SourceNotFoundError: nothing there, or no recording.
        UnreadableSourceError: damaged, or not of a run.
        UsageError: a size that no picture has.
        ViewerError: Rerun's viewer was asked for and does not run here.
    """
    if not all(_SIDE_PX[0] <= side <= _SIDE_PX[1] for side in size_px):
        raise UsageError(
            f"A picture of {size_px[0]} x {size_px[1]} pixels cannot be drawn; each side has {_SIDE_PX[0]} to "
            f"{_SIDE_PX[1]}."
        )
    recording = recording_of_run(path)
    if renderer == "own":
        return RunPicture(_own_picture(path, size_px), "multilica's own renderer")
    try:
        return RunPicture(viewer_picture(recording, size_px), "Rerun's viewer")
    except ViewerError as error:
        if renderer == "rerun":
            raise
        return RunPicture(_own_picture(path, size_px), f"multilica's own renderer; {error}")


def _own_picture(path: Path, size_px: tuple[int, int]) -> bytes:
    contents = contents_of_run(path)
    level = level_pose(contents) or RigidTransform.identity(LEVEL, contents.target)
    return rig_picture(contents, level, size_px)
