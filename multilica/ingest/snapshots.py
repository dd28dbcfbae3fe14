# SPDX-License-Identifier: Apache-2.0
"""Which sources are snapshots of their own."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass

from multilica.config import IngestConfig
from multilica.errors import UnfitSnapshotError, UnknownNameError, UsageError
from multilica.ingest.choice import choose_topics
from multilica.ingest.opening import open_source
from multilica.ingest.reading import DEFAULT_CONFIG, assemble_snapshot
from multilica.ingest.remote_file import SourceFile
from multilica.ingest.source import PathLike, find_source, locate
from multilica.ingest.window import collect_frames

__all__ = ["SnapshotSource", "find_snapshots", "require_lidar"]


@dataclass(frozen=True, slots=True)
class SnapshotSource:
    """What `read_snapshot` takes for one snapshot.

    Args:
        name: after the recording, unique among those found together; fit for a folder's name.
        lidars: names of its LiDARs; empty where it is the only snapshot, or has none.
    """

    name: str
    paths: tuple[SourceFile, ...]
    lidars: tuple[str, ...] = ()


def find_snapshots(sources: Sequence[PathLike], *, config: IngestConfig = DEFAULT_CONFIG) -> tuple[SnapshotSource, ...]:
    """Several recordings, or folders with a bag each, are several snapshots of one rig; all else is one snapshot.

    Point files stay one snapshot, with a file or a folder per LiDAR; so do recordings of which no two share a LiDAR's
    name, as of a recorder per LiDAR.

    Raises:
        SourceNotFoundError: nothing at one of the paths.
        UnreadableSourceError: a recording that cannot be read.
        UsageError: recordings of which only some share a LiDAR's name, or one that is given more than once.
        UnknownNameError: a topic that none of the recordings has.
    """
    paths = tuple(locate(source) for source in sources)
    if len(paths) < 2 or not all(find_source(path).recordings for path in paths):
        return (SnapshotSource(paths[0].stem if paths else "", paths),)
    repeated = [path for path, count in Counter(path.resolve() for path in paths).items() if count > 1]
    if repeated:
        raise UsageError(f"{repeated[0]} is given more than once.")
    whole = config.model_copy(update={"topics": {}, "only": ()})
    lidars = [_lidars(path, whole) for path in paths]
    if _no_name_twice(lidars):
        return (SnapshotSource(paths[0].stem, paths),)
    if config != whole:
        lidars = [_lidars(path, config) for path in paths]
    found = tuple(
        SnapshotSource(name, (path,), names) for name, path, names in zip(_names(paths), paths, lidars, strict=True)
    )
    _require_shared({str(source.paths[0]): source.lidars for source in found if source.lidars})
    return found


def _no_name_twice(lidars: Sequence[tuple[str, ...]]) -> bool:
    """Whether no LiDAR is in two of the recordings, whichever of their topics are asked for."""
    names = [name for each in lidars for name in each]
    return len(names) == len(set(names))


def require_lidar(name: str, sources: Sequence[SnapshotSource]) -> None:
    """Check that one of the snapshots has a LiDAR of that name.

    Raises:
        UnknownNameError: none has.
    """
    lidars = {lidar for source in sources for lidar in source.lidars}
    if name not in lidars:
        raise UnknownNameError("LiDAR", name, lidars, ", ".join(str(path) for each in sources for path in each.paths))


def _lidars(path: SourceFile, config: IngestConfig) -> tuple[str, ...]:
    """Names of the LiDARs; none where nothing can be calibrated, which reading the snapshot will explain."""
    found = find_source(path)
    first = config.model_copy(update={"frames": 1})
    with closing(open_source(found)) as recording:
        try:
            given = choose_topics(recording, config.topics, found.label, config.only)
            window = collect_frames(recording, given.keys(), first, found.label)
        except UnfitSnapshotError:
            return ()
        return assemble_snapshot(found.label, given, window, ((), ())).names


def _require_shared(lidars: Mapping[str, tuple[str, ...]]) -> None:
    for path, names in lidars.items():
        others = sorted({name for other, listed in lidars.items() if other != path for name in listed})
        if others and not {*names} & {*others}:
            raise UsageError(
                f"{path} has the LiDARs {', '.join(names)}, and none of those of the other recordings "
                f"({', '.join(others)}); several recordings are several snapshots of one rig and share LiDAR names "
                "(--topic renames): put the topics of one moment into one recording."
            )


def _names(paths: Sequence[SourceFile]) -> list[str]:
    names: list[str] = []
    stems = Counter(path.resolve().stem for path in paths)
    for path in paths:
        absolute = path.resolve()
        name = absolute.stem if stems[absolute.stem] == 1 else f"{absolute.parent.name}_{absolute.stem}"
        taken = names.count(name)
        names.append(f"{name}_{len(names) + 1}" if taken else name)
    return names
