# SPDX-License-Identifier: Apache-2.0
"""Scenes of OpenCalib's LiDAR-to-LiDAR example, which is also the demo of the paper's code."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from multilica.datasets.scene import DatasetScene, SceneRequest
from multilica.datasets.truth_files import extrinsics_of, read_truth
from multilica.errors import InputError, SourceNotFoundError, UnreadableSourceError
from multilica.ingest import read_snapshot
from multilica.snapshot import LidarScans, Snapshot

_PATHS_FILE = "lidar_cloud_path.txt"
_TARGET = "top"
_ENTRY = re.compile(r"device_id:[ \t]*(\d+)[ \t]*\r?\n[ \t]*path:[ \t]*(\S+)")
AGREED = extrinsics_of(
    _TARGET, {"left": ((0.01, 0.57, -0.40), (-4.2, 45.1, 91.8)), "right": ((-0.03, -0.56, -0.43), (-0.5, 45.8, -86.1))}
)
"""Poses on that vehicle on which four methods agree within 0.02 m and 0.3 to 0.4 degrees; there is no survey."""


def read_scenes(path: Path, request: SceneRequest) -> Iterator[DatasetScene]:
    """Yield the scenes of ``lidar2lidar/auto_calib/data``, or the one of a folder with PCD files, in name order.

    A LiDAR is named after its file, up to the first hyphen. The rough poses of ``initial_extrinsic.txt`` are not used:
    they are a start, no truth, and the paper's method needs none.

    Raises:
        SourceNotFoundError: the path does not exist.
        InputError: it holds no scene, or one of them cannot be read.
    """
    if not path.is_dir():
        raise SourceNotFoundError(
            f"No folder at {path}; give a folder with OpenCalib's PCD files, or one of such folders."
        )
    folders = [folder for folder in (path, *sorted(path.iterdir())) if folder.is_dir() and any(folder.glob("*.pcd"))]
    if not folders:
        raise InputError(f"{path} holds no scene; expected a PCD file per LiDAR, such as top.pcd, or folders of them.")
    given = None if request.truth is None else read_truth(request.truth)
    for folder in folders[: request.scenes]:
        snapshot = _read(folder)
        truth = given or (AGREED if AGREED.members <= {*snapshot.names} else None)
        yield DatasetScene(folder.name, snapshot, truth, _TARGET if _TARGET in snapshot.names else "")


def _read(folder: Path) -> Snapshot:
    files = _files(folder)
    read = read_snapshot(list(files.values()))
    by_stem = {lidar.name: lidar for lidar in read.lidars}
    lidars = [LidarScans(name, by_stem[file.stem].scans) for name, file in files.items()]
    return Snapshot(tuple(lidars), str(folder), read.source_sha256, notes=read.notes)


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
    files = {file.stem.partition("-")[0]: file for file in paths}
    if len(files) < len(paths):
        raise InputError(f"{folder} has several files of one LiDAR ({', '.join(file.name for file in paths)}).")
    return files
