# SPDX-License-Identifier: Apache-2.0
"""The files of a source."""

from __future__ import annotations

import os.path
import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import dropwhile, takewhile
from pathlib import Path
from typing import Literal

from multilica.documents import local_path
from multilica.errors import SourceNotFoundError, UnfitSnapshotError, UnreadableSourceError, UsageError, listed
from multilica.ingest.formats import FORMATS, detect_format, name_unpacked, named_content, named_format
from multilica.ingest.recording import sanitize_text
from multilica.ingest.remote.address import require_readable, scheme_of
from multilica.ingest.remote.remote_file import RemoteFile, SourceFile

PathLike = str | SourceFile

_LISTED = 5
_METADATA = "metadata.yaml"
_PART = re.compile(r"\s*-\s+[\"']?(.+?)[\"']?\s*")
_PART_NUMBER = re.compile(r"_([0-9]{1,9})$")
_NUSCENES = ".pcd.bin"


@dataclass(frozen=True, slots=True)
class FrameFiles:
    """The files of one LiDAR, oldest first; `topic` is the name of the file or folder."""

    topic: str
    lidar: str
    files: tuple[SourceFile, ...]


@dataclass(frozen=True, slots=True)
class Source:
    """The files of a source: of one bag, point files, or a bag per recorder.

    Args:
        recordings: the files of one bag, oldest first.
        frames: the point files of each LiDAR.
        recorders: bags of the same moment with different LiDARs.
        missing: files of the bag that do not exist.
        is_listed: False if nothing but their names says that the files are of one bag.
        skipped: numbers that are missing between those of parts without a first one; None if there is a first one.
        dangling: links in folders to what does not exist.
    """

    label: str
    recordings: tuple[SourceFile, ...] = ()
    frames: tuple[FrameFiles, ...] = ()
    recorders: tuple[Source, ...] = ()
    missing: tuple[str, ...] = ()
    is_listed: bool = True
    skipped: int | None = None
    dangling: tuple[SourceFile, ...] = ()

    @property
    def faults(self) -> tuple[str, ...]:
        """Return notes on files that are there in part, which the user may want to refuse."""
        dangling = [*self.dangling, *(path for source in self.recorders for path in source.dangling)]
        links = "is a link" if len(dangling) == 1 else "are links"
        return (f"{listed(list(map(str, dangling)))} {links} to nothing, and left out.",) if dangling else ()

    @property
    def notes(self) -> tuple[str, ...]:
        """Return what the user should know about the files."""
        notes = [*self.faults]
        notes += [note for source in self.recorders for note in source.notes if note not in source.faults]
        if self.skipped is not None:
            between = f", nor {self.skipped} between the others" if self.skipped else ""
            notes.append(
                f"The bag begins with {self.recordings[0].name}: its first parts are not in the folder{between}."
            )
        return tuple(notes)

    @property
    def files(self) -> tuple[SourceFile, ...]:
        """Every file, in order."""
        frames = tuple(path for lidar in self.frames for path in lidar.files)
        return self.recordings + frames + tuple(path for source in self.recorders for path in source.files)


def find_source(source: PathLike | Sequence[PathLike]) -> Source:
    """Find the files by their names, and by their first bytes where the names do not tell.

    Raises:
        SourceNotFoundError: nothing exists at one of the paths.
        UnreadableSourceError: a file is empty, of an unknown format, or not accessible.
        UnfitSnapshotError: a folder has nothing to read.
        UsageError: no source, several recordings in a folder, or an address of an unknown kind.
    """
    given = [source] if isinstance(source, PathLike) else list(source)
    paths = [locate(path) for path in given]
    if not paths:
        raise UsageError("No source was given; expected a recording, a folder or point files.")
    try:
        missing = [path for path in paths if not path.exists()]
        if missing:
            raise SourceNotFoundError(f"Nothing exists at {missing[0]}.")
        return _several(paths) if len(paths) > 1 else _look_at(paths[0])
    except OSError as error:
        raise UnreadableSourceError(f"{error.filename} cannot be opened: {error.strerror}.") from error


def locate(source: PathLike) -> SourceFile:
    """Return a path on disk or a remote file, which need not exist; raise UsageError if the address is not valid."""
    if isinstance(source, RemoteFile):
        return source
    require_readable(source)
    if scheme_of(source):
        return RemoteFile(str(source))
    return local_path(source)


def names_of(paths: Sequence[SourceFile]) -> tuple[str, ...]:
    """Return the sources as results name them, without the folders of this machine; addresses stay as they are.

    Files of one name are named from the folder that holds all of them.
    """
    local = [Path(os.path.abspath(path)) for path in paths if isinstance(path, Path)]  # noqa: PTH100 - links stay
    above = Path(os.path.commonpath([path.parent for path in local])) if local else Path()
    repeated = len({path.name for path in local}) < len(local)
    names = iter([str(path.relative_to(above)) if repeated else path.name for path in local])
    return tuple(next(names) if isinstance(path, Path) else str(path) for path in paths)


def listed_names(paths: Sequence[SourceFile]) -> str:
    """Return the sources as results name them, the first of many."""
    return ", ".join(names_of(paths)[:_LISTED]) + (", ..." if len(paths) > _LISTED else "")


def without_folders(texts: Sequence[str], paths: Sequence[SourceFile]) -> tuple[str, ...]:
    """Return texts about sources with their names in place of their paths."""
    named = zip(paths, names_of(paths), strict=True)
    names = {sanitize_text(path): name for path, name in named if isinstance(path, Path) and len(path.parts) > 1}
    longest_first = sorted(names, key=len, reverse=True) if texts else []
    for path in longest_first:
        texts = [text.replace(path, sanitize_text(names[path])) for text in texts]
    return tuple(texts)


def require_distinct(paths: Sequence[SourceFile]) -> None:
    """Raise UsageError if a path is given twice."""
    repeated = [path for path, count in Counter(path.resolve() for path in paths).items() if count > 1]
    if repeated:
        raise UsageError(f"{repeated[0]} is given more than once.")


def are_stops(paths: Sequence[SourceFile]) -> bool:
    """Return whether each path is a folder with a snapshot of the same LiDARs, rather than with frames of one LiDAR.

    Folders of point files are stops if all hold files of the same names, two or more; further ones are of LiDARs that
    other stops lack. Names that only count, as in 0001.pcd and 0002.pcd, are frames of one LiDAR. Folders of folders
    with frames are stops if two or more of these have the same names, whatever the names.
    """
    if len(paths) < 2 or not all(isinstance(path, Path) and path.is_dir() for path in paths):
        return False
    sources = [_look_at(path) for path in paths]
    names = set.intersection(*({lidar.topic for lidar in source.frames} for source in sources))
    if any(source.recordings for source in sources) or len(names) < 2:
        return False
    are_folders = all((path / name).is_dir() for path in paths for name in names)
    return are_folders or _are_lidars(names)


def _are_lidars(names: Collection[str]) -> bool:
    """Return whether names are of LiDARs rather than of frames, which only count."""
    return len({re.sub(r"\d+", "#", name) for name in names}) > 1


TakenFor = Literal["a recording", "a point cloud of one LiDAR", "frames of one LiDAR", "LiDARs of one snapshot"]


def taken_for(paths: Sequence[SourceFile]) -> tuple[TakenFor, ...]:
    """Return what each of the sources that are given together is taken for."""
    are_alone = len(paths) == 1 or are_stops(paths)
    return tuple(_taken_for(path, is_alone=are_alone) for path in paths)


def _taken_for(path: SourceFile, *, is_alone: bool) -> TakenFor:
    source = _look_at(path)
    if source.recordings:
        return "a recording"
    if not path.is_dir():
        return "a point cloud of one LiDAR"
    return "LiDARs of one snapshot" if is_alone else "frames of one LiDAR"


def _look_at(path: SourceFile) -> Source:
    if path.is_dir():
        return _folder(path)
    if not path.is_file():
        raise UnreadableSourceError(f"{path} is neither a file nor a folder.")
    if detect_format(path).content != "cloud":
        return Source(str(path), recordings=(path,))
    return Source(str(path), frames=(FrameFiles(path.name, _stem(path), (path,)),))


def _several(paths: list[SourceFile]) -> Source:
    label = ", ".join(str(path) for path in paths[:_LISTED]) + (", ..." if len(paths) > _LISTED else "")
    require_distinct(paths)
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
    return Source(label, frames=tuple(lidars), dangling=tuple(link for source in sources for link in source.dangling))


def _folder(folder: SourceFile) -> Source:
    entries = _entries(folder)
    files = [entry for entry in entries if entry.is_file()]
    recordings = [path for path in files if named_content(path) == "recording"]
    frames = _frames(entries)
    _require_lidars(folder, frames)
    if recordings and frames:
        raise UsageError(
            f"{folder} holds recordings ({_names(recordings)}) and point files ({frames[0].topic}, ...); "
            "give one of them."
        )
    if not recordings and not frames:
        raise UnfitSnapshotError(
            f"{folder} holds no point clouds; expected point files, folders of them, or a bag, "
            f"found {_names(entries) or 'nothing'}."
        )
    if len(recordings) > 1 and not _are_one_bag(folder, recordings):
        raise UsageError(
            f"{folder} holds {len(recordings)} recordings ({_names(recordings)}); give one of them by its name, "
            "or several of them if each holds another LiDAR."
        )
    is_listed = len(recordings) < 2 or (folder / _METADATA).exists()
    missing, numbers = _missing_parts(folder, recordings), _numbers(recordings)
    skipped = None if is_listed or 0 in numbers else max(numbers) - min(numbers) + 1 - len(numbers)
    dangling = tuple(_dangling([entry for entry in entries if isinstance(entry, Path)]))
    return Source(str(folder), tuple(recordings), tuple(frames), (), missing, is_listed, skipped, dangling)


def _entries(folder: SourceFile) -> list[SourceFile]:
    """Return what is in a folder, without hidden files, in the order of the names and their numbers."""
    return sorted((entry for entry in folder.iterdir() if not entry.name.startswith(".")), key=_natural)


def _dangling(entries: Sequence[Path]) -> Iterator[Path]:
    """Yield the links to files of points, recordings or folders that do not exist; also those one folder below."""
    below = (path for entry in entries if entry.is_dir() for path in sorted(entry.iterdir()))
    for path in (*entries, *below):
        is_meant = not path.suffix or named_content(path) in ("cloud", "recording")
        if is_meant and path.is_symlink() and not path.exists():
            yield path


def _require_lidars(folder: SourceFile, frames: Sequence[FrameFiles]) -> None:
    """Raise UsageError if the folders are stops, each with a point file per LiDAR, rather than LiDARs."""
    names = [{_stem(path) for path in each.files} for each in frames]
    common = set.intersection(*names) if len(names) > 1 else set()
    if _are_lidars(common):
        raise UsageError(
            f"{folder} holds {len(frames)} folders with point files of the same names ({listed(sorted(common))}), as "
            f"stops of a drive with a file per LiDAR; give the folders themselves, as {folder}/*/. If each is a LiDAR, "
            "name its frames by number, as 0001.pcd."
        )


def _frames(entries: list[SourceFile]) -> list[FrameFiles]:
    clouds = [entry for entry in entries if _is_cloud_file(entry)]
    stems = Counter(map(_stem, clouds))
    single = [FrameFiles(path.name, _stem(path) if stems[_stem(path)] == 1 else path.name, (path,)) for path in clouds]
    folders = [
        FrameFiles(entry.name, entry.name, files)
        for entry in entries
        # A bucket may have any number of folders, with a request for each.
        if isinstance(entry, Path)
        and entry.is_dir()
        and (files := tuple(sorted(filter(_is_cloud_file, entry.iterdir()), key=_natural)))
    ]
    return single + folders


def _stem(path: SourceFile) -> str:
    """Return the name without its suffix, which has two parts for nuScenes."""
    return path.name.removesuffix(_NUSCENES) if path.name.endswith(_NUSCENES) else path.stem


def _is_cloud_file(path: SourceFile) -> bool:
    return named_content(path) == "cloud" and not path.name.startswith(".") and path.is_file()


def _natural(path: SourceFile) -> tuple[list[int | str], str]:
    parts = re.split(r"(\d+)", path.name)
    return [int(part) if index % 2 else part for index, part in enumerate(parts)], path.name


def _names(paths: list[SourceFile]) -> str:
    shown = ", ".join(path.name for path in paths[:_LISTED])
    return f"{shown}, ..." if len(paths) > _LISTED else shown


def _are_one_bag(folder: SourceFile, recordings: Sequence[SourceFile]) -> bool:
    """Return whether files of a folder are parts of one bag rather than separate recordings."""
    if any(named_format(path) is FORMATS["ros1"] for path in recordings):
        return False
    # The parts of a split bag are NAME_0.db3, NAME_1.db3, ... If the recorder dies, metadata.yaml is missing, and the
    # last part is not compressed yet where the others are (NAME_0.db3.zstd). A rolling log loses its first parts.
    names, numbers = {_PART_NUMBER.sub("", _unpacked_stem(path)) for path in recordings}, _numbers(recordings)
    is_split = len(names) == 1 and (0 in numbers or len(numbers) == len(recordings))
    return is_split or (folder / _METADATA).exists()


def _numbers(recordings: Sequence[SourceFile]) -> set[int]:
    """Return the numbers of those that are named like parts of a split bag."""
    return {int(found[1]) for path in recordings if (found := _PART_NUMBER.search(_unpacked_stem(path)))}


def _unpacked_stem(path: SourceFile) -> str:
    return Path(name_unpacked(path.name)).stem


def _missing_parts(folder: SourceFile, recordings: Sequence[SourceFile]) -> tuple[str, ...]:
    """Return the files that metadata.yaml names and that do not exist, compressed or not."""
    try:
        with (folder / _METADATA).open("rb") as file:
            lines = file.read().decode(errors="replace").splitlines()
    except (OSError, SourceNotFoundError):
        return ()
    existing = {name_unpacked(path.name) for path in recordings}
    behind = list(dropwhile(lambda line: line.strip() != "relative_file_paths:", lines))[1:]
    named = [Path(found[1]).name for found in takewhile(bool, map(_PART.fullmatch, behind)) if found]
    return tuple(name for name in named if name_unpacked(name) not in existing)
