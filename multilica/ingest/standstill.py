# SPDX-License-Identifier: Apache-2.0
"""When the vehicle stands still, from samples of what tells its motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby

from multilica.ingest.motion_evidence import by_clouds, by_imu, by_odometry
from multilica.ingest.recording import Recording, Span

__all__ = ["Standstill", "find_standstill"]

_MIN_NS = 10**9
"""A vehicle that turns round stands still for less."""

Evidence = Callable[[Recording, Span], tuple[str, Sequence[tuple[int, bool]]] | None]
_EVIDENCE: tuple[Evidence, ...] = (by_odometry, by_imu, by_clouds)
"""The most direct first; each gives its name with log times and whether the vehicle stands still then, or None."""


@dataclass(frozen=True, slots=True)
class Standstill:
    """The longest stretch, in log times.

    Args:
        evidence: what shows it, for instance ``odometry on '/odom'``.
    """

    start_ns: int
    end_ns: int
    evidence: str


def find_standstill(recording: Recording, span: Span) -> Standstill | None:
    """The longest stretch of at least a second, or all there is, in which every sample stands still; None without one.

    Only samples are read, a few hundred whatever the length of the recording: what moves between two of them is left
    to the check of the frames themselves.
    """
    for look in _EVIDENCE:
        found = look(recording, span)
        if found is not None:
            name, samples = found
            runs = [[time_ns for time_ns, _ in run] for still, run in groupby(samples, key=lambda s: s[1]) if still]
            longest = max(runs, key=lambda run: run[-1] - run[0], default=[0])
            if samples and all(still for _, still in samples):
                # What is too short to tell more about it is taken whole.
                return Standstill(*span, name)
            if longest[-1] - longest[0] < _MIN_NS:
                return None
            return Standstill(longest[0], longest[-1], name)
    return None
