# SPDX-License-Identifier: Apache-2.0
"""The time range that frames are taken from: as configured, or where the vehicle stands still."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from datetime import UTC, datetime

from multilica.config import IngestConfig
from multilica.errors import ConfigError, UnfitSnapshotError
from multilica.ingest.recording import Recording, Span
from multilica.ingest.selection.standstill import Standstills, find_standstills, has_single_frames
from multilica.ingest.selection.topics import ChosenRecording, cloud_span

_NS_PER_S = 1_000_000_000
_MAX_SPREAD_S = 30.0
_MIN_NANOSECONDS = 10**17
"""Larger numbers are nanoseconds since the epoch (this is 1973), smaller ones seconds."""


@dataclass(frozen=True, slots=True)
class TimeRange:
    """A range of log times.

    Args:
        end_ns: exclusive; frames are spread up to it, or taken one after the other from the start on if it is None.
        is_dense: True if frames are taken one after the other up to `end_ns`.
    """

    start_ns: int = 0
    end_ns: int | None = None
    is_dense: bool = False
    notes: tuple[str, ...] = ()


def find_time_range(recording: Recording, config: IngestConfig, label: str, topics: Collection[str]) -> TimeRange:
    """Return the configured time range; a standstill is found by the clouds on these topics.

    Raises:
        ConfigError: a time is not valid, or two beginnings are given.
        UnfitSnapshotError: the recording ends before it, or the vehicle never stands still.
    """
    if config.start_at and config.start_s:
        raise ConfigError("Found both ingest.start_s and ingest.start_at; expected one of them.")
    if not (config.start_at or config.start_s or config.window_s or config.window == "auto"):
        return TimeRange()
    span = cloud_span(recording)
    if span is None:
        key = next(key for key in ("start_at", "start_s", "window_s", "window") if getattr(config, key))
        return TimeRange(notes=(f"Point files have no time: ingest.{key} has no effect.",))
    start_ns = start_of(span, config, label)
    if config.window == "auto":
        return _still_range(ChosenRecording(recording, topics), config, start_ns, span, label)
    if not config.window_s:
        return TimeRange(start_ns)
    end_ns = start_ns + round(config.window_s * _NS_PER_S)
    if end_ns <= span[1]:
        return TimeRange(start_ns, end_ns)
    left_s = (span[1] - start_ns) / _NS_PER_S
    note = f"The recording ends {left_s:.1f} s after the window begins; frames are spread over that time."
    return TimeRange(start_ns, span[1] + 1, notes=(note,))


def parse_time_ns(text: str) -> int:
    """Parse ISO 8601, or seconds or nanoseconds since the epoch, to nanoseconds; raise ConfigError for others."""
    if text.isdecimal() and int(text) >= _MIN_NANOSECONDS:
        return int(text)
    try:
        return round(float(text) * _NS_PER_S)
    except (ValueError, OverflowError):
        pass
    try:
        time = datetime.fromisoformat(text)
    except ValueError as error:
        raise ConfigError(
            f"Cannot read the time '{text}' in ingest.start_at; expected ISO 8601, as in 2026-05-04T12:30:00Z, "
            "or seconds or nanoseconds since the epoch."
        ) from error
    since_epoch = (time if time.tzinfo else time.replace(tzinfo=UTC)) - datetime.fromtimestamp(0, UTC)
    return (since_epoch.days * 86400 + since_epoch.seconds) * _NS_PER_S + since_epoch.microseconds * 1000


def start_of(span: Span, config: IngestConfig, label: str) -> int:
    """Return the log time from which on frames are taken; raise UnfitSnapshotError if the recording ends before."""
    if config.start_at:
        start_ns = parse_time_ns(config.start_at)
        if not span[0] - _NS_PER_S <= start_ns <= span[1]:
            raise UnfitSnapshotError(
                f"{label} has no point cloud at {config.start_at}: they span {_utc(span[0])} to {_utc(span[1])}; "
                "set ingest.start_at (--start) to a time between."
            )
        return start_ns
    duration_s = (span[1] - span[0]) / _NS_PER_S
    if config.start_s > duration_s:
        raise UnfitSnapshotError(
            f"{label} has no point cloud {config.start_s:g} s after its first one: they span {duration_s:.3f} s; "
            "set ingest.start_s (--start) to less."
        )
    return span[0] + round(config.start_s * _NS_PER_S)


def _still_range(recording: Recording, config: IngestConfig, start_ns: int, span: Span, label: str) -> TimeRange:
    found = find_standstills(recording, (start_ns, span[1]))
    require_standstill(found, label)
    if has_single_frames(recording):
        return TimeRange(start_ns, notes=("There is one frame per LiDAR, so no standstill to choose.",))
    longest = max(found.spans, key=lambda each: each[1] - each[0])
    return still_range(longest, span, config, found.evidence)


def still_range(standstill: Span, span: Span, config: IngestConfig, evidence: str) -> TimeRange:
    """Return the time range of a standstill from its beginning on, in a recording of a span of log times."""
    longest_s = config.window_s or _MAX_SPREAD_S
    first_ns, last_ns = standstill
    end_ns = min(last_ns + 1, first_ns + round(longest_s * _NS_PER_S))
    first_s, last_s = ((time_ns - span[0]) / _NS_PER_S for time_ns in standstill)
    note = f"The vehicle stands still from {first_s:.1f} to {last_s:.1f} s by {evidence}; frames are from there."
    return TimeRange(first_ns, end_ns, notes=(note,))


def require_standstill(found: Standstills, label: str) -> None:
    """Raise UnfitSnapshotError unless there is a standstill."""
    if found.spans:
        return
    if found.is_known:
        raise UnfitSnapshotError(
            f"In {label} the vehicle never stands still, by {found.evidence}; expected a second or more of standstill.",
            code="moving_vehicle",
        )
    raise UnfitSnapshotError(
        f"In {label} nothing shows when the vehicle stands still: there is no readable odometry or IMU, and "
        f"{found.evidence} show too little, as in a tunnel; choose a time with --start (ingest.start_s).",
        code="unknown_standstill",
    )


def _utc(time_ns: int) -> str:
    try:
        return datetime.fromtimestamp(time_ns / _NS_PER_S, UTC).isoformat(timespec="milliseconds")
    except (ValueError, OverflowError):
        return f"{time_ns / _NS_PER_S:.3f} s"
