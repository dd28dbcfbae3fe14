# SPDX-License-Identifier: Apache-2.0
"""The time in which the vehicle stands still."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import groupby

from multilica.errors import UnfitSnapshotError
from multilica.ingest.recording import Recording, Span
from multilica.ingest.selection.motion_evidence import Evidence, by_clouds, by_imu, by_odometry

__all__ = ["Standstill", "find_standstill"]

_MIN_NS = 10**9
"""A vehicle that turns round stands still for less."""
_EVIDENCE: tuple[Callable[[Recording, Span], Evidence], ...] = (by_odometry, by_imu, by_clouds)
"""The most direct first."""


@dataclass(frozen=True, slots=True)
class Standstill:
    """A range of log times.

    Args:
        evidence: what shows it, for instance ``odometry on '/odom'``.
    """

    start_ns: int
    end_ns: int
    evidence: str


def find_standstill(recording: Recording, span: Span, label: str) -> Standstill:
    """Find the longest time of at least a second, or the whole span, in which the vehicle stands still.

    Only a few hundred samples are read, whatever the length of the recording. Motion between two of them is left to
    the check of the frames.

    Args:
        label: the source, for messages.

    Raises:
        UnfitSnapshotError: the vehicle never stands still, or nothing shows whether it does.
    """
    name, samples = next(found for look in _EVIDENCE if (found := look(recording, span)) is not None)
    if samples and all(still for _, still in samples):
        return Standstill(*span, name)
    runs = [[time_ns for time_ns, _ in run] for still, run in groupby(samples, key=lambda s: s[1]) if still]
    longest = max(runs, key=lambda run: run[-1] - run[0], default=[0])
    if longest[-1] - longest[0] >= _MIN_NS:
        return Standstill(longest[0], longest[-1], name)
    if any(still is not None for _, still in samples):
        raise UnfitSnapshotError(
            f"In {label} the vehicle never stands still, by {name}; expected a second or more of standstill."
        )
    raise UnfitSnapshotError(
        f"In {label} nothing shows when the vehicle stands still: there is no readable odometry or IMU, and {name} "
        "show too little, as in a tunnel; choose a time with --start (ingest.start_s)."
    )
