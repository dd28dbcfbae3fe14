# SPDX-License-Identifier: Apache-2.0
"""The reason why a LiDAR has no scan in the window, by when its topic begins and ends."""

from __future__ import annotations

from collections.abc import Collection

from multilica.ingest.recording import Recording, Span
from multilica.ingest.selection.topics import cloud_span

_NS_PER_S = 1_000_000_000
_STEP_NS = 100_000_000
"""Precision of a time that is named for `--start`, from which on one may wait for the first scan."""
_DAY_S = 86_400


def why_absent(recording: Recording, topic: str, present: Collection[str], start_ns: int) -> str:
    """Return a clause on when a topic has scans, and what to do; empty if its span does not tell.

    Args:
        present: topics with scans in the window, which begins at `start_ns`.
    """
    whole, own = cloud_span(recording), recording.span_ns([topic])
    spans = [span for each in sorted(present) if (span := recording.span_ns([each])) is not None]
    if whole is None or own is None or not spans:
        return ""
    others = max(first_ns for first_ns, _ in spans), min(last_ns for _, last_ns in spans)
    common_ns = max(own[0], others[0])
    if common_ns > min(own[1], others[1]):
        return "" if others[0] > others[1] else _of_another_time(own, others)
    advice = f"--start {(common_ns - whole[0]) // _STEP_NS * _STEP_NS / _NS_PER_S:g} has all"
    if start_ns < own[0]:
        return f"its scans begin {_length(own[0] - start_ns)} after the window begins; {advice}"
    return f"its scans end {_length(start_ns - own[1])} before the window begins; {advice}" if own[1] < start_ns else ""


def _of_another_time(own: Span, others: Span) -> str:
    """Return a clause on a topic that has no time in common with the others."""
    is_later = own[0] > others[0]
    apart = f"begin {_length(own[0] - others[1])} after" if is_later else f"end {_length(others[0] - own[1])} before"
    offset = f"{_length(abs(own[0] - others[0]))} {'ahead' if is_later else 'behind'}"
    return (
        f"its scans {apart} those of the others. If all were recorded at once, its clock is {offset}: set the clocks "
        "of the recorders, or shift the times of its recording; else record all LiDARs at once"
    )


def _length(duration_ns: int) -> str:
    """Return a length of time in seconds, or in days if it is long; what does not overlap may still be 0.0 s."""
    length_s = max(0, duration_ns) / _NS_PER_S
    return f"{length_s:.1f} s" if length_s < _DAY_S else f"{length_s / _DAY_S:.0f} days"
