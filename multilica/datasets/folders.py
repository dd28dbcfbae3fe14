# SPDX-License-Identifier: Apache-2.0
"""Data sets with a recording or a folder of point files per scene: EDGAR's and OpenCalib's."""

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

from multilica.config import IngestConfig
from multilica.datasets.scene import MAIN_LIDAR, DatasetScene, SceneRequest, extrinsics_of, find_truth, read_truth
from multilica.errors import InputError, SourceNotFoundError, UnreadableSourceError
from multilica.ingest import read_snapshot
from multilica.ingest.formats import Content, named_format
from multilica.ingest.locate import find_source
from multilica.snapshot import LidarScans, Snapshot

_PATHS_FILE = "lidar_cloud_path.txt"
_TARGET = "top"
_COUNT = re.compile(r"[\d._-]+")
_ENTRY = re.compile(r"device_id:[ \t]*(\d+)[ \t]*\r?\n[ \t]*path:[ \t]*(\S+)")
AGREED = extrinsics_of(
    _TARGET, {"left": ((0.01, 0.57, -0.40), (-4.2, 45.1, 91.8)), "right": ((-0.03, -0.56, -0.43), (-0.5, 45.8, -86.1))}
)
"""Poses on that vehicle on which four methods agree within 0.02 m and 0.3 to 0.4 degrees; there is no survey."""


def read_edgar(path: Path, request: SceneRequest) -> Iterator[DatasetScene]:
    """Yield the scenes of EDGAR, the vehicle of the paper: one per recording or folder of point files, in name order.

    The recordings are not public. Users who have some keep them as the paper's code reads them: a ROS 2 bag per scene,
    or a folder per scene with PCD files per LiDAR, and the truth in the form of the authors' evaluation files.

    The longest standstill of a recording is used. The truth of a scene is in its folder, else in `path`.

    Raises:
        SourceNotFoundError: the path does not exist.
        InputError: it holds no scene, or one of them cannot be read.
    """
    sources = _sources(path)[: request.scenes]
    stems = Counter(_stem(source) for source in sources)
    for source in sources:
        file = request.truth or find_truth(source, path if path.is_dir() else path.parent)
        truth = None if file is None else read_truth(file)
        target = MAIN_LIDAR if truth is not None and MAIN_LIDAR in truth.members else ""
        config = IngestConfig(
            frames=request.frames,
            topics=dict(request.topics),
            window="auto" if find_source(source).recordings else "start",
        )
        name = _stem(source) if stems[_stem(source)] == 1 else source.name
        yield DatasetScene(name, read_snapshot(source, config=config), truth, target)


def _stem(source: Path) -> str:
    return source.stem if source.is_file() else source.name


def _sources(path: Path) -> list[Path]:
    if not path.exists():
        raise SourceNotFoundError(f"Nothing exists at {path}; give a ROS 2 bag, or a folder with one entry per scene.")
    if path.is_file() or _is_scene(path):
        return [path]
    found = [entry for entry in sorted(path.iterdir()) if (_is_scene(entry) if entry.is_dir() else _is_read(entry))]
    if not found:
        raise InputError(
            f"{path} holds no scene; expected ROS 2 bags, or folders with a PCD file or a folder of frames per LiDAR."
        )
    return found


def _is_scene(folder: Path) -> bool:
    """Return whether a folder is a bag, or has a point file, or a folder of frames, per LiDAR.

    Names of digits only, as 0001.pcd, are those of frames; lidar_1.pcd is a LiDAR.
    """
    if (folder / "metadata.yaml").is_file() or any(_is_read(entry, "cloud") for entry in folder.iterdir()):
        return True
    folders = [entry for entry in folder.iterdir() if entry.is_dir() and not entry.name.startswith(".")]
    frames = [file.stem for each in folders for file in each.iterdir() if _is_read(file, "cloud")]
    return bool(frames) and all(map(_COUNT.fullmatch, frames))


def _is_read(file: Path, content: Content = "recording") -> bool:
    named = named_format(file)
    return file.is_file() and not file.name.startswith(".") and named is not None and named.content == content


def read_opencalib(path: Path, request: SceneRequest) -> Iterator[DatasetScene]:
    """Yield the scenes of OpenCalib's example ``lidar2lidar/auto_calib/data``, or of a folder with PCD files, by name.

    It is also the demo of the paper's code. A LiDAR is named after its file, up to the first hyphen. The rough poses of
    ``initial_extrinsic.txt`` are not used: they are a start, no truth, and the paper's method needs none.

    Raises:
        SourceNotFoundError: the path does not exist.
        InputError: it holds no scene, none with a LiDAR of the truth, or one that cannot be read.
    """
    if not path.is_dir():
        raise SourceNotFoundError(
            f"No folder at {path}; give a folder with OpenCalib's PCD files, or one of such folders."
        )
    folders = [folder for folder in (path, *sorted(path.iterdir())) if folder.is_dir() and any(folder.glob("*.pcd"))]
    if not folders:
        raise InputError(f"{path} holds no scene; expected a PCD file per LiDAR, such as top.pcd, or folders of them.")
    given = None if request.truth is None else read_truth(request.truth)
    known = (AGREED if given is None else given).members
    if not any(_lidar_of(file) in known for folder in folders for file in folder.glob("*.pcd")):
        whose = "data set" if given is None else "truth"
        raise InputError(
            f"{path} holds no scene with a LiDAR of the {whose} ({', '.join(sorted(known))}); expected a PCD file per "
            "LiDAR of that name, such as top.pcd."
        )
    for folder in folders[: request.scenes]:
        files = _files(folder)
        named = IngestConfig(topics={name: file.name for name, file in files.items()})
        read = read_snapshot(list(files.values()), config=named)
        lidars = [LidarScans(lidar.name, lidar.scans) for lidar in read.lidars]
        snapshot = Snapshot(tuple(lidars), str(folder), read.source_sha256, notes=read.notes)
        truth = given or (AGREED if AGREED.members <= {*snapshot.names} else None)
        yield DatasetScene(folder.resolve().name, snapshot, truth, _TARGET if _TARGET in snapshot.names else "")


def _lidar_of(file: Path) -> str:
    return file.stem.partition("-")[0]


def _files(folder: Path) -> Mapping[str, Path]:
    """Return the file of each LiDAR: those that ``lidar_cloud_path.txt`` lists, else all."""
    index = folder / _PATHS_FILE
    if index.is_file():
        paths = [folder / Path(listed).name for _, listed in _ENTRY.findall(index.read_text(encoding="latin1"))]
        missing = [file.name for file in paths if not file.is_file()]
        if missing or not paths:
            what = f"names {', '.join(missing)}, which is not there" if missing else "lists no file"
            raise UnreadableSourceError(f"{index} {what}; expected 'device_id: N' and 'path: FILE' per LiDAR.")
    else:
        paths = sorted(folder.glob("*.pcd"))
    files = {_lidar_of(file): file for file in paths}
    if len(files) < len(paths):
        raise InputError(f"{folder} has several files of one LiDAR ({', '.join(file.name for file in paths)}).")
    return files
