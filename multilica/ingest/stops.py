# SPDX-License-Identifier: Apache-2.0
"""The stops of a drive: a few standstills at different places that see much."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import pairwise
from statistics import median
from typing import TYPE_CHECKING

import numpy as np

from multilica.config import IngestConfig, StillnessConfig
from multilica.errors import InputError, UnreadableSourceError, UsageError
from multilica.geometry import LEVER_ARM_M, lengths
from multilica.ingest.locate import PathLike, find_source, locate
from multilica.ingest.memory import limited_memory
from multilica.ingest.message_types import decode_cloud
from multilica.ingest.metadata import config_for, stops_recorded
from multilica.ingest.opening import open_source
from multilica.ingest.recording import DamagedRecordingError, ProgressObserver, Recording, Span
from multilica.ingest.remote.remote_file import SourceFile
from multilica.ingest.selection.sampling import sampled
from multilica.ingest.selection.standstill import (
    Standstills,
    find_standstills,
    has_single_frames,
    richest_topics,
    untold,
)
from multilica.ingest.selection.time_range import TimeRange, require_standstill, start_of, still_range
from multilica.ingest.selection.topics import ChosenRecording, choose_topics, cloud_span
from multilica.ingest.snapshot_reader import read_ranges
from multilica.ingest.snapshot_sources import find_snapshots
from multilica.snapshot import Scan, Snapshot

if TYPE_CHECKING:
    from multilica.stages.stillness import Motion

MOST_STOPS = 4
"""Stops that `find_stops` chooses unless it is asked for another number."""
_NS_PER_S = 1_000_000_000
_MOST_CANDIDATES = 16
_MOST_TOPICS = 2
NEW_PLACE_M = 2.0
"""Way, or turn as a way at the lever arm, beyond which a stop shows something new."""
_NEW_PLACE_S = 3.0
"""Driving time beyond which a vehicle is elsewhere, where no LiDAR can tell."""
_CLOSE_S = 20.0
"""Driving time between two stops that halves the hope that they have surfaces in common."""
_CELL_M = 1.0
_SEEN_M = 40.0


@dataclass(frozen=True, slots=True)
class Stop:
    """A standstill to read a snapshot from, or a source that is a snapshot as a whole.

    Args:
        paths: sources of the snapshot, for `read_snapshot`.
        span_ns: log times of its beginning and its end; None if the source is read as a whole.
        start_s, end_s: the same in seconds after the first scan of the log; None as above.
        why: why it was chosen, as a sentence.
    """

    paths: tuple[SourceFile, ...]
    why: str
    span_ns: Span | None = None
    start_s: float | None = None
    end_s: float | None = None
    times: TimeRange | None = None


def find_stops(
    sources: PathLike | Sequence[PathLike], *, config: IngestConfig | None = None, most: int = MOST_STOPS
) -> tuple[Stop, ...]:
    """Find standstills of a log that differ in place or heading and see much, oldest first.

    Several recordings or folders that are snapshots of one rig are a stop each. Only a few hundred samples of a log
    are read. If it has frames of a single time, or no time at all, it is one stop.

    Args:
        config: topics, and the time from which on stops are looked for.
        most: largest number of stops of a log.

    Raises:
        MultilicaError: as `read_snapshot` with the window "auto": the source cannot be read, or never stands still.
        UsageError: less than one stop is asked for.
    """
    paths = [locate(each) for each in ([sources] if isinstance(sources, PathLike) else sources)]
    snapshots = find_snapshots(paths, config=config)
    if len(snapshots) > 1:
        return tuple(Stop(each.paths, "The source is one of several snapshots of one rig.") for each in snapshots)
    return search_log(paths, config, most)


def search_log(
    paths: Sequence[SourceFile], config: IngestConfig | None, most: int, observe: ProgressObserver = untold
) -> tuple[Stop, ...]:
    """Find the stops of a log, as `find_stops`; `observe` is called with each sample."""
    if most < 1:
        raise UsageError(f"Found {most} stops asked for; expected one or more.")
    found = find_source(paths)
    config = config or config_for(found.files)
    with limited_memory(config.max_memory_mb, found.label), closing(open_source(found)) as recording:
        chosen_topics = choose_topics(recording, config.topics, found.label, config.only)
        span, lidars = cloud_span(recording), ChosenRecording(recording, chosen_topics)
        if span is None or has_single_frames(lidars):
            why = "It has no time." if span is None else "There is one frame per LiDAR, so no standstill to choose."
            return (Stop(tuple(paths), why),)
        start_ns = start_of(span, config, found.label)
        recorded = tuple(each for each in stops_recorded(found.files) if each[0] >= start_ns)
        if recorded and most >= len(recorded):
            return tuple(_recorded_stop(tuple(paths), each, span, config) for each in recorded)
        standstills = find_standstills(lidars, (start_ns, span[1]), observe)
        require_standstill(standstills, found.label)
        chosen = _choose(lidars, standstills, most)
    return tuple(_stop(tuple(paths), each, why, span, config, standstills.evidence) for each, why in chosen)


def read_stops(
    stops: Sequence[Stop], *, config: IngestConfig | None = None, observe: ProgressObserver = untold
) -> tuple[Snapshot, ...]:
    """Read the snapshot of each stop; its source tells which of several it is.

    Args:
        observe: called with each stop of a log.

    Raises:
        MultilicaError: as `read_snapshot`.
    """
    snapshots: list[Snapshot] = []
    for index, stop in enumerate(stops):
        if index < len(snapshots):
            continue
        together = [each for each in stops[index:] if each.paths == stop.paths]
        read = read_ranges(stop.paths, [each.times for each in together], config=config, observe=observe)
        if len(stops) > 1 and stop.times is not None:
            read = tuple(replace(each, source=f"{each.source}, stop {number + 1}") for number, each in enumerate(read))
        snapshots += read
    return tuple(snapshots)


def standstills_of(recording: Recording, topics: Collection[str]) -> Standstills | None:
    """Return the standstills of a log, by clouds on the topics; None if it has too little time, or nothing tells."""
    span, chosen = cloud_span(recording), ChosenRecording(recording, topics)
    if span is None or span[1] - span[0] < 2 * _NS_PER_S or has_single_frames(chosen):
        return None
    try:
        return find_standstills(chosen, span)
    except InputError:
        return None


def _stop(paths: tuple[SourceFile, ...], at: Span, why: str, span: Span, config: IngestConfig, evidence: str) -> Stop:
    start_s, end_s = ((time_ns - span[0]) / _NS_PER_S for time_ns in at)
    return Stop(paths, why, at, start_s, end_s, still_range(at, span, config, evidence))


def _recorded_stop(paths: tuple[SourceFile, ...], at: Span, span: Span, config: IngestConfig) -> Stop:
    """Return a stop that the recorder saved: each of its frames is wanted, wherever it lies in time."""
    stop = _stop(paths, at, "It was recorded.", span, config, "`multilica record`")
    return replace(stop, times=replace(stop.times, end_ns=at[1] + 1, is_dense=True) if stop.times else None)


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    """A standstill with a scan of each of the richest LiDARs; `seen` counts the cells that these see."""

    span: Span
    scans: Mapping[str, Scan]
    seen: int


def _choose(recording: Recording, standstills: Standstills, most: int) -> list[tuple[Span, str]]:
    """Return the chosen standstills with the reasons, oldest first."""
    spans = standstills.spans
    if len(spans) > _MOST_CANDIDATES:
        spans = _closest(spans)
    if len(spans) == 1 or most == 1:
        longest = max(spans, key=lambda each: each[1] - each[0])
        return [(longest, "It is the only standstill." if len(spans) == 1 else "It is the longest standstill.")]
    candidates = _look_around(recording, spans)
    hopes = [each.seen * _closeness(each, [c for c in candidates if c is not each]) for each in candidates]
    best = candidates[hopes.index(max(hopes))]
    chosen, reasons = [best], {best.span: f"It sees the most near others: {best.seen} cells of 1 m."}
    rest = [each for each in candidates if each is not best]
    while rest and len(chosen) < most:
        rest.sort(key=lambda each: (-each.seen * _closeness(each, chosen), each.span))
        added = rest.pop(0)
        offsets = [_offset(each, added) for each in chosen]
        if any(offset is not None and offset < NEW_PLACE_M for offset in offsets):
            continue
        known = [offset for offset in offsets if offset is not None]
        away = f"{min(known):.1f} m or more from the others" if len(known) == len(offsets) else "elsewhere"
        chosen.append(added)
        reasons[added.span] = f"It is {away}, and sees {added.seen} cells of 1 m."
    return sorted((each.span, reasons[each.span]) for each in chosen)


def _closest(spans: tuple[Span, ...]) -> tuple[Span, ...]:
    """Return as many standstills in a row as are looked at, with the least driving time between them."""
    starts = range(len(spans) - _MOST_CANDIDATES + 1)
    rows = [spans[start : start + _MOST_CANDIDATES] for start in starts]
    return min(rows, key=lambda row: sum(later[0] - earlier[1] for earlier, later in pairwise(row)))


def _look_around(recording: Recording, spans: Sequence[Span]) -> list[_Candidate]:
    """Decode a scan of the richest LiDARs in the middle of each standstill."""
    topics = richest_topics(recording, (spans[0][0], spans[-1][1]))[:_MOST_TOPICS]
    found: list[dict[str, Scan]] = [{} for _ in spans]
    times_ns = [(first_ns + last_ns) // 2 for first_ns, last_ns in spans]
    try:
        for index, message in sampled(recording, topics, times_ns, spans[-1][1] + 1, jump_ns=0):
            if message.log_time_ns <= spans[index][1]:
                try:
                    found[index][message.topic] = decode_cloud(message).scan
                except UnreadableSourceError:
                    continue
    except DamagedRecordingError:
        pass
    return [
        _Candidate(span, scans, sum(map(_seen_cells, scans.values()))) for span, scans in zip(spans, found, strict=True)
    ]


def _seen_cells(scan: Scan) -> int:
    near_m = scan.points_m[lengths(scan.points_m) < _SEEN_M]
    return len(np.unique(np.floor(near_m / _CELL_M).astype(np.int64), axis=0))


def _closeness(one: _Candidate, others: Sequence[_Candidate]) -> float:
    """Return how much hope there is for surfaces in common, from 0 to 1, by the driving time to the nearest."""
    gap_s = min(_gap_s(one.span, other.span) for other in others)
    return 1.0 / (1.0 + gap_s / _CLOSE_S)


def _gap_s(one: Span, other: Span) -> float:
    return max(0, one[0] - other[1], other[0] - one[1]) / _NS_PER_S


def _offset(one: _Candidate, other: _Candidate) -> float | None:
    """Return how far apart two standstills are in metres, turns at the lever arm; None: elsewhere."""
    is_told, offset_m = offset_between(one.scans, other.scans)
    if is_told or _gap_s(one.span, other.span) >= _NEW_PLACE_S:
        return offset_m
    return 0.0


def offset_between(one: Mapping[str, Scan], other: Mapping[str, Scan]) -> tuple[bool, float | None]:
    """Return whether scans of the same LiDARs tell how far apart they are, and how far; None: elsewhere, or untold."""
    from multilica.stages.stillness import detect_motion

    config = StillnessConfig()
    motions = [
        detect_motion([one[name], other[name]], config, track=False) for name in sorted(one.keys() & other.keys())
    ]
    telling = [motion for motion in motions if motion.observable]
    followed = [motion for motion in telling if not motion.at_least]
    if followed and 2 * len(followed) >= len(telling):
        return True, float(median(map(_size_m, followed)))
    return bool(telling), None


def _size_m(motion: Motion) -> float:
    return float(np.hypot(motion.shift_m, LEVER_ARM_M * motion.turn_rad)) if motion.moving else 0.0
