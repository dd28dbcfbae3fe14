# SPDX-License-Identifier: Apache-2.0
"""The time range that frames are taken from."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import groupby

from multilica.config import IngestConfig
from multilica.errors import ConfigError, UnfitSnapshotError
from multilica.ingest.messages.cloud import is_cloud
from multilica.ingest.recording import Recording, Span
from multilica.ingest.selection.motion_evidence import Evidence, by_clouds, by_imu, by_odometry

_NS_PER_S = 1_000_000_000
_MAX_SPREAD_S = 30.0
_MIN_NANOSECONDS = 10**17
"""Larger numbers are nanoseconds since the epoch (this is 1973), smaller ones seconds."""
_MIN_STANDSTILL_NS = 10**9
"""A vehicle that turns round stands still for less."""
_EVIDENCE: tuple[Callable[[Recording, Span], Evidence], ...] = (by_odometry, by_imu, by_clouds)
"""The most direct first."""


@dataclass(frozen=True, slots=True)
class TimeRange:
    """A range of log times; frames are spread up to `end_ns`, or taken one after the other if it is None."""

    start_ns: int = 0
    end_ns: int | None = None
    notes: tuple[str, ...] = ()


def find_time_range(recording: Recording, config: IngestConfig, label: str) -> TimeRange:
    """Return the configured time range.

    Raises:
        ConfigError: a time is not valid, or two beginnings are given.
        UnfitSnapshotError: the recording ends before it, or the vehicle never stands still.
    """
    if config.start_at and config.start_s:
        raise ConfigError("Found both ingest.start_s and ingest.start_at; expected one of them.")
    if not (config.start_at or config.start_s or config.window_s or config.window == "auto"):
        return TimeRange()
    span = recording.span_ns({topic.name for topic in recording.topics if is_cloud(topic)})
    if span is None:
        key = next(key for key in ("start_at", "start_s", "window_s", "window") if getattr(config, key))
        return TimeRange(notes=(f"Point files have no time: ingest.{key} has no effect.",))
    start_ns = _start_ns(span, config, label)
    if config.window == "auto":
        return _still_range(recording, config, start_ns, span, label)
    if not config.window_s:
        return TimeRange(start_ns)
    end_ns = start_ns + round(config.window_s * _NS_PER_S)
    if end_ns <= span[1]:
        return TimeRange(start_ns, end_ns)
    left_s = (span[1] - start_ns) / _NS_PER_S
    note = f"The recording ends {left_s:.1f} s after the window begins; frames are spread over that time."
    return TimeRange(start_ns, span[1] + 1, (note,))


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


def _start_ns(span: Span, config: IngestConfig, label: str) -> int:
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
    first_ns, last_ns, evidence = _standstill(recording, (start_ns, span[1]), label)
    longest_s = config.window_s or _MAX_SPREAD_S
    end_ns = min(last_ns, first_ns + round(longest_s * _NS_PER_S))
    first_s, last_s = ((time_ns - span[0]) / _NS_PER_S for time_ns in (first_ns, last_ns))
    note = f"The vehicle stands still from {first_s:.1f} to {last_s:.1f} s by {evidence}; frames are from there."
    return TimeRange(first_ns, end_ns, (note,))


def _standstill(recording: Recording, span: Span, label: str) -> tuple[int, int, str]:
    """Return the longest time of at least a second, or the whole span, of standstill, and what shows it.

    Only a few hundred samples are read, whatever the length of the recording. Motion between two of them is left to
    the check of the frames.
    """
    name, samples = next(found for look in _EVIDENCE if (found := look(recording, span)) is not None)
    if samples and all(still for _, still in samples):
        return *span, name
    runs = [[time_ns for time_ns, _ in run] for still, run in groupby(samples, key=lambda s: s[1]) if still]
    longest = max(runs, key=lambda run: run[-1] - run[0], default=[0])
    if longest[-1] - longest[0] >= _MIN_STANDSTILL_NS:
        return longest[0], longest[-1], name
    if any(still is not None for _, still in samples):
        raise UnfitSnapshotError(
            f"In {label} the vehicle never stands still, by {name}; expected a second or more of standstill."
        )
    raise UnfitSnapshotError(
        f"In {label} nothing shows when the vehicle stands still: there is no readable odometry or IMU, and {name} "
        "show too little, as in a tunnel; choose a time with --start (ingest.start_s)."
    )


def _utc(time_ns: int) -> str:
    try:
        return datetime.fromtimestamp(time_ns / _NS_PER_S, UTC).isoformat(timespec="milliseconds")
    except (ValueError, OverflowError):
        return f"{time_ns / _NS_PER_S:.3f} s"
