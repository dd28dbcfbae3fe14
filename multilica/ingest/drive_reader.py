# SPDX-License-Identifier: Apache-2.0
"""The snapshots of a drive: those of several recordings, or of the stops of one log if it has several."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Literal

from multilica.config import IngestConfig
from multilica.errors import InputError, UnreadableSourceError
from multilica.ingest.locate import PathLike, find_source, locate
from multilica.ingest.memory import MemoryLimitError, limited_memory
from multilica.ingest.message_types import decode_cloud
from multilica.ingest.metadata import config_for, stops_recorded
from multilica.ingest.opening import open_source
from multilica.ingest.recording import ProgressObserver, Recording, Span
from multilica.ingest.remote.remote_file import SourceFile
from multilica.ingest.selection.sampling import sampled
from multilica.ingest.selection.standstill import has_single_frames, richest_topics, untold
from multilica.ingest.selection.topics import ChosenRecording, choose_topics, cloud_span
from multilica.ingest.snapshot_reader import read_snapshot
from multilica.ingest.snapshot_sources import find_snapshots
from multilica.ingest.stops import MOST_STOPS, Stop, read_stops, search_log
from multilica.ingest.ways import read_motions
from multilica.snapshot import Scan, Snapshot

_LEAST_DRIVE_NS = 4 * 10**9
"""Two standstills of a second each and the way between them take longer."""
_NO_STOPS = (
    "The vehicle drives in this log, and fewer than two stops of a second were found: only frames of one place "
    "are used; choose others with --start or --window."
)
_LOOKS = 4
_LAST_NS = 10**9
"""Before the end of a log, so that each LiDAR still sends a frame."""


def stops_of_log(
    paths: Sequence[SourceFile],
    wanted: int | Literal["auto"],
    *,
    config: IngestConfig | None = None,
    observe: ProgressObserver = untold,
) -> tuple[Stop, ...]:
    """Find the stops of a log that `drive.stops` asks for.

    "auto" looks at a few frames first, and searches only if the vehicle drives in between.

    Args:
        paths: of one snapshot.
        observe: called with each sample of a search.

    Returns:
        None of them if the log is read as one snapshot. So it is with "auto" if the configuration chooses its frames,
        if it has no index, or unless it has several stops. A log that drives without them is one stop without times.

    Raises:
        MultilicaError: as `find_stops`, for a number of stops.
    """
    if wanted == 1:
        return ()
    if wanted != "auto":
        return search_log(paths, config, wanted, observe)
    if config is not None and (config.start_at or config.start_s or config.window_s or config.window == "auto"):
        return ()
    stops: tuple[Stop, ...] = ()
    drives = False
    # Reading the snapshot tells what is wrong with the source.
    with suppress(InputError):
        recorded = len(stops_recorded(find_source(paths).files))
        drives = _drives(paths, config)
        if recorded > 1 or drives:
            stops = search_log(paths, config, max(recorded, MOST_STOPS), observe)
    return stops if len(stops) > 1 else (Stop(tuple(paths), _NO_STOPS),) if drives else ()


def read_drive(
    sources: PathLike | Sequence[PathLike], wanted: int | Literal["auto"], *, config: IngestConfig | None = None
) -> tuple[Snapshot, ...]:
    """Read the snapshots of several recordings of one rig, or of the stops of a log that `drive.stops` asks for.

    Raises:
        MultilicaError: as `find_snapshots`, `find_stops` or `read_snapshot`.
    """
    paths = [locate(each) for each in ([sources] if isinstance(sources, PathLike) else sources)]
    several = find_snapshots(paths, config=config)
    if len(several) > 1:
        return tuple(read_snapshot(each.paths, config=config) for each in several)
    stops = stops_of_log(paths, wanted, config=config)
    return read_log(stops, wanted, config=config) if stops else (read_snapshot(paths, config=config),)


def read_log(
    stops: Sequence[Stop],
    wanted: int | Literal["auto"],
    *,
    config: IngestConfig | None = None,
    observe: ProgressObserver = untold,
) -> tuple[Snapshot, ...]:
    """Read the snapshots of the stops of a log, with notes on why each was chosen.

    With "auto", the last ones are left out if all take too much memory.

    Args:
        observe: called with each stop.

    Raises:
        MultilicaError: as `read_snapshot`.
    """
    kept = [*stops]
    while True:
        try:
            read = read_stops(kept, config=config, observe=observe)
            break
        except MemoryLimitError:
            if wanted != "auto" or len(kept) == 1:
                raise
            kept.pop()
    snapshots = [
        replace(snapshot, notes=(*snapshot.notes, stop.why)) if stop.times or stop.why == _NO_STOPS else snapshot
        for snapshot, stop in zip(read, kept, strict=True)
    ]
    snapshots = _with_ways(snapshots, kept, config)
    if len(kept) < len(stops):
        told = f"{len(kept)} of {len(stops)} stops are used: more take more memory than ingest.max_memory_mb allows."
        snapshots[0] = replace(snapshots[0], notes=(*snapshots[0].notes, told))
    if wanted != "auto" and (told := too_few_stops(stops, wanted)):
        snapshots[0] = replace(snapshots[0], notes=(*snapshots[0].notes, told))
    return tuple(snapshots)


def too_few_stops(stops: Sequence[Stop], wanted: int | Literal["auto"]) -> str:
    """Return a sentence if `stops_of_log` found fewer stops than asked for, or none in a log that drives."""
    if wanted != "auto" and 0 < len(stops) < wanted:
        return f"{wanted} stops of different place or heading were asked for, and {len(stops)} found."
    return stops[0].why if [stop.why for stop in stops] == [_NO_STOPS] else ""


def _with_ways(snapshots: list[Snapshot], stops: Sequence[Stop], config: IngestConfig | None) -> list[Snapshot]:
    """Add what reads the motions of the LiDARs since the previous stop of the log."""
    spans = [stop.span_ns for stop in stops if stop.span_ns is not None]
    if len(spans) < len(stops):
        return snapshots
    lidars = {lidar.topic: lidar.name for snapshot in snapshots for lidar in snapshot.lidars}
    paths = stops[0].paths
    ways = [partial(read_motions, paths, lidars, *way, config=config) for way in pairwise(spans)]
    return [snapshots[0], *(replace(each, read_motions=way) for each, way in zip(snapshots[1:], ways, strict=True))]


def _drives(paths: Sequence[SourceFile], config: IngestConfig | None) -> bool:
    """Return whether the vehicle is elsewhere in one of a few frames, spread over an indexed log, than in the first."""
    from multilica.stages.stillness import leaves_its_place

    found = find_source(paths)
    if found.frames:
        return False
    config = config or config_for(found.files)
    with limited_memory(config.max_memory_mb, found.label), closing(open_source(found)) as recording:
        chosen = ChosenRecording(recording, choose_topics(recording, config.topics, found.label, config.only))
        span = cloud_span(chosen) if recording.is_indexed else None
        if span is None or span[1] - span[0] < _LEAST_DRIVE_NS or has_single_frames(chosen):
            return False
        return any(leaves_its_place(_spread(chosen, topic, span)) for topic in richest_topics(chosen, span)[:1])


def _spread(recording: Recording, topic: str, span: Span) -> Iterator[Scan]:
    """Yield the first frame of a LiDAR, its last one, and some between."""
    length_ns = span[1] - span[0]
    for number in (0, *range(_LOOKS, 0, -1)):
        start_ns = min(span[0] + length_ns * number // _LOOKS, span[1] - _LAST_NS)
        with suppress(UnreadableSourceError):
            for _, message in sampled(recording, [topic], [max(span[0], start_ns)], span[1] + 1):
                yield decode_cloud(message).scan
