# SPDX-License-Identifier: Apache-2.0
"""From when to when frames are taken."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

from multilica.config import IngestConfig
from multilica.errors import ConfigError, UnfitSnapshotError
from multilica.ingest.cloud import is_cloud
from multilica.ingest.recording import Recording, Span
from multilica.ingest.standstill import find_standstill

__all__ = ["TimeRange", "find_time_range", "parse_time_ns"]

_NS_PER_S = 1_000_000_000
_LONGEST_SPREAD_S = 30.0
_LEAST_NS = 10**17
"""As seconds, three billion years; as nanoseconds, in 1973."""


@dataclass(frozen=True, slots=True)
class TimeRange:
    """Log times.

    Args:
        end_ns: None where frames are taken one after the other; else they are spread up to there.
        notes: what the user should know.
    """

    start_ns: int = 0
    end_ns: int | None = None
    notes: tuple[str, ...] = ()


def find_time_range(recording: Recording, config: IngestConfig, label: str) -> TimeRange:
    """What the configuration asks for.

    Args:
        label: the source, for messages.

    Raises:
        ConfigError: a time that cannot be read, or two beginnings.
        UnfitSnapshotError: the recording ends before that, or the vehicle never stands still.
    """
    if config.start_at and config.start_s:
        raise ConfigError("Found ingest.start_s beside ingest.start_at; expected one of them.")
    if not (config.start_at or config.start_s or config.window_s or config.window == "auto"):
        return TimeRange()
    span = recording.span_ns({topic.name for topic in recording.topics if is_cloud(topic)})
    if span is None:
        return TimeRange(notes=(f"Point files have no time: ingest.{_asked(config)} has no effect.",))
    start_ns = _start_ns(span, config, label)
    if config.window == "auto":
        return _still_range(recording, config, start_ns, span, label)
    if config.window_s:
        return _spread(config, start_ns, span[1])
    return TimeRange(start_ns)


def parse_time_ns(text: str) -> int:
    """Nanoseconds since the epoch, of ISO 8601, of seconds since the epoch or of nanoseconds since then.

    Raises:
        ConfigError: it is none of them.
    """
    if text.isdecimal() and int(text) >= _LEAST_NS:
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


def _spread(config: IngestConfig, start_ns: int, last_ns: int) -> TimeRange:
    wanted_ns = start_ns + round(config.window_s * _NS_PER_S)
    if wanted_ns <= last_ns:
        return TimeRange(start_ns, wanted_ns)
    left_s = (last_ns - start_ns) / _NS_PER_S
    note = f"The recording ends {left_s:.1f} s after the window begins; frames are spread over that."
    return TimeRange(start_ns, last_ns + 1, (note,))


def _still_range(recording: Recording, config: IngestConfig, start_ns: int, span: Span, label: str) -> TimeRange:
    found = find_standstill(recording, (start_ns, span[1]), label)
    longest_s = config.window_s or _LONGEST_SPREAD_S
    end_ns = min(found.end_ns, found.start_ns + round(longest_s * _NS_PER_S))
    first_s, last_s = ((time_ns - span[0]) / _NS_PER_S for time_ns in (found.start_ns, found.end_ns))
    note = f"The vehicle stands still from {first_s:.1f} to {last_s:.1f} s by {found.evidence}; frames are from there."
    return TimeRange(found.start_ns, end_ns, (note,))


def _asked(config: IngestConfig) -> str:
    return next(key for key in ("start_at", "start_s", "window_s", "window") if getattr(config, key))


def _utc(time_ns: int) -> str:
    try:
        return datetime.fromtimestamp(time_ns / _NS_PER_S, UTC).isoformat(timespec="milliseconds")
    except (ValueError, OverflowError):
        return f"{time_ns / _NS_PER_S:.3f} s"
