# SPDX-License-Identifier: Apache-2.0
"""Picture of a saved run."""

from pathlib import Path

from multilica.errors import SourceNotFoundError, UsageError
from multilica.runs.run_documents import read_run_document
from multilica.sinks.rerun.viewer import viewer_picture

__all__ = ["picture_of_run", "recording_of_run"]

_SIDE_PX = (64, 8192)


def recording_of_run(path: Path) -> Path:
    """Return the recording of a run directory, whole or cut off, or the recording itself.

    Raises:
        SourceNotFoundError: nothing there, or no recording.
    """
    if path.suffix == ".rrd" and path.is_file():
        return path
    recording = read_run_document(path).recording
    if recording is None:
        raise SourceNotFoundError(f"{path} has no recording beside it, which `multilica calibrate` writes.")
    return recording


def picture_of_run(path: Path, size_px: tuple[int, int]) -> bytes:
    """Draw the first view of a run as PNG, without a screen.

    Args:
        path: a run directory or a recording.
        size_px: width and height.

    Raises:
        SourceNotFoundError: nothing there, or no recording.
        UnreadableSourceError: damaged, or not of a run.
        UsageError: the size is out of range.
        ViewerError: Rerun's viewer does not run here.
    """
    if not all(_SIDE_PX[0] <= side <= _SIDE_PX[1] for side in size_px):
        raise UsageError(
            f"Found a picture size of {size_px[0]} x {size_px[1]} pixels; expected {_SIDE_PX[0]} to {_SIDE_PX[1]} "
            "per side."
        )
    return viewer_picture(recording_of_run(path), size_px)
