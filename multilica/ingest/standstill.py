# SPDX-License-Identifier: Apache-2.0
"""When the vehicle stands still, from samples of what tells its motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import groupby

from multilica.errors import UnfitSnapshotError
from multilica.ingest.motion_evidence import Witness, by_clouds, by_imu, by_odometry
from multilica.ingest.recording import Recording, Span

__all__ = ["Standstill", "find_standstill"]

_MIN_NS = 10**9
"""A vehicle that turns round stands still for less."""

_EVIDENCE: tuple[Callable[[Recording, Span], Witness], ...] = (by_odometry, by_imu, by_clouds)
"""The most direct first."""


@dataclass(frozen=True, slots=True)
class Standstill:
    """The longest stretch, in log times.

    Args:
        evidence: what shows it, for instance ``odometry on '/odom'``.
    """

    start_ns: int
    end_ns: int
    evidence: str


def find_standstill(recording: Recording, span: Span, label: str) -> Standstill:
    """The longest stretch of at least a second, or all there is, in which every sample stands still.

    Only samples are read, a few hundred whatever the length of the recording: what moves between two of them is left
    to the check of the frames themselves.

    Args:
        label: the source, for messages.

    Raises:
        UnfitSnapshotError: there is none, or nothing tells.
    """
    name, samples = next(found for look in _EVIDENCE if (found := look(recording, span)) is not None)
    if samples and all(still for _, still in samples):
        # What is too short to tell more about it is taken whole.
        return Standstill(*span, name)
    runs = [[time_ns for time_ns, _ in run] for still, run in groupby(samples, key=lambda s: s[1]) if still]
    longest = max(runs, key=lambda run: run[-1] - run[0], default=[0])
    if longest[-1] - longest[0] >= _MIN_NS:
        return Standstill(longest[0], longest[-1], name)
    if any(still is not None for _, still in samples):
        raise UnfitSnapshotError(
            f"In {label} the vehicle never stands still, by {name}; expected a stretch of a second or more."
        )
    raise UnfitSnapshotError(
        f"In {label} nothing tells when the vehicle stands still: no odometry and no IMU can be read, and {name} show "
        "too little, as in a tunnel; choose a time with --start (ingest.start_s)."
    )
