# SPDX-License-Identifier: Apache-2.0
"""Which files a source is made of."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from multilica.errors import SourceNotFoundError, UnfitSnapshotError, UnreadableSourceError, UsageError
from multilica.ingest.address import require_readable, scheme_of
from multilica.ingest.bag_folder import are_one_bag, missing_parts
from multilica.ingest.cloud_files import FrameFiles
from multilica.ingest.detect import (
    CLOUD_SUFFIXES,
    PACKED,
    PACKED_SUFFIXES,
    RECORDING_SUFFIXES,
    detect_format,
    named_format,
)
from multilica.ingest.remote_file import RemoteFile, SourceFile

__all__ = ["PathLike", "Source", "find_source", "locate"]

PathLike = str | SourceFile

_LISTED = 5
_NUSCENES = ".pcd.bin"


@dataclass(frozen=True, slots=True)
class Source:
    """The files behind a source: those of one bag, point files, or a bag per recorder.

    Args:
        label: the source as the user named it.
        recordings: the files of one bag, oldest first.
        frames: the point files of each LiDAR.
        recorders: bags that were recorded at the same time, with different LiDARs each.
        missing: files that belong to the bag and are not there.
    """

    label: str
    recordings: tuple[SourceFile, ...] = ()
    frames: tuple[FrameFiles, ...] = ()
    recorders: tuple[Source, ...] = ()
    missing: tuple[str, ...] = ()

    @property
    def files(self) -> tuple[SourceFile, ...]:
        """Every file, in order."""
        frames = tuple(path for lidar in self.frames for path in lidar.files)
        return self.recordings + frames + tuple(path for source in self.recorders for path in source.files)


def find_source(source: PathLike | Sequence[PathLike]) -> Source:
    """Look at the paths, and at the first bytes of files whose names do not say what they are.

    Raises:
        SourceNotFoundError: nothing at one of the paths.
        UnreadableSourceError: an empty file, one of no format that is read here, or one that its server withholds.
        UnfitSnapshotError: a folder with nothing to read.
        UsageError: several recordings, or none at all; an address of a kind that is not read here.
    """
    given = [source] if isinstance(source, PathLike) else list(source)
    paths = [locate(path) for path in given]
    if not paths:
        raise UsageError("No source was given; expected a recording, a folder or point files.")
    try:
        return _find(paths)
    except OSError as error:
        raise UnreadableSourceError(f"{error.filename} cannot be opened: {error.strerror}.") from error


def locate(source: PathLike) -> SourceFile:
    """The file or folder behind what a user gave: of the disk, or at an address. It need not exist.

    Raises:
        UsageError: an address of a kind that is not read here.
    """
    if isinstance(source, RemoteFile):
        return source
    require_readable(source)
    return RemoteFile(str(source)) if scheme_of(source) else Path(source).expanduser()


def _find(paths: list[SourceFile]) -> Source:
    for path in paths:
        if not path.exists():
            raise SourceNotFoundError(f"Nothing exists at {path}.")
    if len(paths) > 1:
        return _several(paths)
    return _look_at(paths[0])


def _look_at(path: SourceFile) -> Source:
    return _folder(path) if isinstance(path, Path) and path.is_dir() else _file(path)


def _file(path: SourceFile) -> Source:
    if not path.is_file():
        raise UnreadableSourceError(f"{path} is neither a file nor a folder.")
    if detect_format(path) in (*RECORDING_SUFFIXES.values(), PACKED):
        return Source(str(path), recordings=(path,))
    return Source(str(path), frames=(FrameFiles(path.name, _stem(path), (path,)),))


def _several(paths: list[SourceFile]) -> Source:
    label = ", ".join(str(path) for path in paths[:_LISTED]) + (", ..." if len(paths) > _LISTED else "")
    repeated = [path for path, count in Counter(path.resolve() for path in paths).items() if count > 1]
    if repeated:
        raise UsageError(f"{repeated[0]} is given more than once.")
    sources = [_look_at(path) for path in paths]
    if all(source.recordings for source in sources):
        return Source(label, recorders=tuple(sources))
    names, stems = Counter(path.name for path in paths), Counter(map(_stem, paths))
    lidars: list[FrameFiles] = []
    for path, source in zip(paths, sources, strict=True):
        if source.recordings:
            raise UsageError(f"{path} is a recording among point files; give recordings alone, or point files alone.")
        topic = path.name if names[path.name] == 1 else str(path)
        lidar = _stem(path) if stems[_stem(path)] == 1 else f"{path.parent.name}_{_stem(path)}"
        lidars.append(FrameFiles(topic, path.name if path.is_dir() else lidar, source.files))
    return Source(label, frames=tuple(lidars))


def _folder(folder: Path) -> Source:
    entries = sorted((entry for entry in folder.iterdir() if not entry.name.startswith(".")), key=_natural)
    files = [entry for entry in entries if entry.is_file()]
    recordings = [path for path in files if _is_recording(path)]
    frames = _frames(entries)
    if recordings and frames:
        raise UsageError(
            f"{folder} holds recordings ({_names(recordings)}) as well as point files ({frames[0].topic}, ...); "
            "give the one that is meant."
        )
    if not recordings and not frames:
        raise UnfitSnapshotError(
            f"{folder} holds no point clouds; expected point files, folders of them, or a bag, "
            f"found {_names(entries) or 'nothing'}."
        )
    if len(recordings) > 1 and not are_one_bag(folder, recordings):
        raise UsageError(
            f"{folder} holds {len(recordings)} recordings ({_names(recordings)}); give one of them by its name, "
            "or several of them if each holds another LiDAR."
        )
    return Source(str(folder), tuple(recordings), tuple(frames), missing=missing_parts(folder, recordings))


def _frames(entries: list[Path]) -> list[FrameFiles]:
    clouds = [entry for entry in entries if _is_cloud_file(entry)]
    stems = Counter(map(_stem, clouds))
    single = [FrameFiles(path.name, _stem(path) if stems[_stem(path)] == 1 else path.name, (path,)) for path in clouds]
    folders = [
        FrameFiles(entry.name, entry.name, files)
        for entry in entries
        if entry.is_dir() and (files := tuple(sorted(filter(_is_cloud_file, entry.iterdir()), key=_natural)))
    ]
    return single + folders


def _stem(path: SourceFile) -> str:
    """The name without what tells the format, of which nuScenes has two parts."""
    return path.name.removesuffix(_NUSCENES) if path.name.endswith(_NUSCENES) else path.stem


def _is_recording(path: Path) -> bool:
    return named_format(path) in RECORDING_SUFFIXES.values() or path.suffix.lower() in PACKED_SUFFIXES


def _is_cloud_file(path: Path) -> bool:
    return path.suffix.lower() in CLOUD_SUFFIXES and not path.name.startswith(".") and path.is_file()


def _natural(path: Path) -> tuple[list[int | str], str]:
    parts = re.split(r"(\d+)", path.name)
    return [int(part) if index % 2 else part for index, part in enumerate(parts)], path.name


def _names(paths: list[Path]) -> str:
    shown = ", ".join(path.name for path in paths[:_LISTED])
    return f"{shown}, ..." if len(paths) > _LISTED else shown
