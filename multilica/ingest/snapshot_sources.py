# SPDX-License-Identifier: Apache-2.0
"""Sources that form one snapshot together, or are several snapshots of one rig."""

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass

from multilica.config import IngestConfig
from multilica.errors import UnfitSnapshotError, UnknownNameError, UsageError
from multilica.ingest.fingerprint import sha256_of_files
from multilica.ingest.locate import PathLike, are_stops, find_source, locate, require_distinct
from multilica.ingest.memory import limited_memory
from multilica.ingest.opening import open_source
from multilica.ingest.remote.remote_file import RemoteFile, SourceFile
from multilica.ingest.selection.topics import choose_topics, named_topics
from multilica.ingest.selection.window import collect_frames
from multilica.ingest.snapshot_reader import assemble_snapshot


@dataclass(frozen=True, slots=True)
class SnapshotSource:
    """The sources of one snapshot, for `read_snapshot`.

    Args:
        name: of the recording, unique among those found together; valid as a folder's name.
        lidars: names of its LiDARs; empty if it is the only snapshot, or has none.
    """

    name: str
    paths: tuple[SourceFile, ...]
    lidars: tuple[str, ...] = ()


def find_snapshots(sources: Sequence[PathLike], *, config: IngestConfig | None = None) -> tuple[SnapshotSource, ...]:
    """Split sources into snapshots of one rig.

    Several recordings, or folders with a bag each, are several snapshots if they share LiDAR names. Recordings without
    a common LiDAR, as from one recorder per LiDAR, are one snapshot; so are point files. Folders that hold the same
    LiDARs, with a point file or a folder of frames each, are a snapshot each.

    Raises:
        SourceNotFoundError: nothing exists at one of the paths.
        UnreadableSourceError: a recording cannot be read.
        UsageError: only some of the recordings share a LiDAR name, or one is given more than once, perhaps as a copy.
        UnknownNameError: none of the recordings has a topic.
    """
    config = config or IngestConfig()
    paths = tuple(locate(source) for source in sources)
    if are_stops(paths):
        _require_different(paths)
        return tuple(
            SnapshotSource(name, (path,), tuple(sorted(lidar.lidar for lidar in find_source(path).frames)))
            for name, path in zip(_snapshot_names(paths), paths, strict=True)
        )
    if len(paths) < 2 or not all(find_source(path).recordings for path in paths):
        return (SnapshotSource(paths[0].stem if paths else "", paths),)
    require_distinct(paths)
    whole = config.model_copy(update={"topics": {}, "only": ()})
    lidars = [_lidars(path, whole) for path in paths]
    names = [name for each in lidars for name in each]
    if len(names) == len(set(names)):
        return (SnapshotSource(paths[0].stem, paths),)
    if config != whole:
        lidars = [_lidars(path, config) for path in paths]
    named = zip(_snapshot_names(paths), paths, lidars, strict=True)
    found = tuple(SnapshotSource(name, (path,), each) for name, path, each in named)
    _require_shared({str(source.paths[0]): source.lidars for source in found if source.lidars})
    _require_different(paths)
    return found


def require_lidar(name: str, sources: Sequence[SnapshotSource]) -> None:
    """Raise UnknownNameError unless one of the snapshots has a LiDAR of that name."""
    lidars = {lidar for source in sources for lidar in source.lidars}
    if name not in lidars:
        raise UnknownNameError("LiDAR", name, lidars, ", ".join(str(path) for each in sources for path in each.paths))


def _lidars(path: SourceFile, config: IngestConfig) -> tuple[str, ...]:
    """Return the names of the LiDARs; none if reading the snapshot will fail."""
    found = find_source(path)
    first = config.model_copy(update={"frames": 1})
    with limited_memory(config.max_memory_mb, found.label), closing(open_source(found)) as recording:
        try:
            given = choose_topics(recording, config.topics, found.label, config.only)
            window = collect_frames(recording, given.keys(), first, found.label)
        except UnfitSnapshotError:
            return ()
        return assemble_snapshot(found.label, given, window, chosen=named_topics(given, config)).names


def _require_different(paths: Sequence[SourceFile]) -> None:
    """Raise UsageError if two local sources are the same, or a copy: they would count twice."""
    require_distinct(paths)
    alike: dict[tuple[int, ...], list[SourceFile]] = {}
    for path in paths:
        files = find_source(path).files
        if not any(isinstance(file, RemoteFile) for file in files):
            alike.setdefault(tuple(sorted(file.stat().st_size for file in files)), []).append(path)
    for of_one_size in alike.values():
        known: dict[str, SourceFile] = {}
        for path in of_one_size if len(of_one_size) > 1 else ():
            first = known.setdefault(sha256_of_files(find_source(path).files), path)
            if first is not path:
                raise UsageError(f"{first} and {path} hold the same data; give one of them, or it counts twice.")


def _require_shared(lidars: Mapping[str, tuple[str, ...]]) -> None:
    for path, names in lidars.items():
        others = sorted({name for other, listed in lidars.items() if other != path for name in listed})
        if others and not {*names} & {*others}:
            raise UsageError(
                f"{path} has the LiDARs {', '.join(names)}, and none of those of the other recordings "
                f"({', '.join(others)}); several recordings are several snapshots of one rig and must share LiDAR "
                "names (--topic renames): put the topics of one moment into one recording."
            )


def _snapshot_names(paths: Sequence[SourceFile]) -> list[str]:
    names: list[str] = []
    stems = Counter(path.resolve().stem for path in paths)
    for path in paths:
        absolute = path.resolve()
        name = absolute.stem if stems[absolute.stem] == 1 else f"{absolute.parent.name}_{absolute.stem}"
        names.append(f"{name}_{len(names) + 1}" if name in names else name)
    return names
