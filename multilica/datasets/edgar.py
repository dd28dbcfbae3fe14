# SPDX-License-Identifier: Apache-2.0
"""Scenes of EDGAR, the vehicle of the paper.

Its recordings are not public. Users who have some keep them as the paper's code reads them: a ROS 2 bag per scene, or a
folder per scene with PCD files per LiDAR, and the truth in the form of the authors' evaluation files.
"""

from collections.abc import Iterator
from pathlib import Path

from multilica.config import IngestConfig
from multilica.datasets.scene import DatasetScene, SceneRequest
from multilica.datasets.truth_files import MAIN_LIDAR, find_truth, read_truth
from multilica.errors import InputError, SourceNotFoundError
from multilica.ingest import read_snapshot
from multilica.ingest.formats import Content, named_format
from multilica.ingest.locate import find_source


def read_scenes(path: Path, request: SceneRequest) -> Iterator[DatasetScene]:
    """Yield a scene per recording or folder of point files, in name order.

    The longest standstill of a recording is used. The truth of a scene is in its folder, else in `path`.

    Raises:
        SourceNotFoundError: the path does not exist.
        InputError: it holds no scene, or one of them cannot be read.
    """
    for source in _sources(path)[: request.scenes]:
        file = request.truth or find_truth(source, path if path.is_dir() else path.parent)
        truth = None if file is None else read_truth(file)
        target = MAIN_LIDAR if truth is not None and MAIN_LIDAR in truth.members else ""
        config = IngestConfig(
            frames=request.frames,
            topics=dict(request.topics),
            window="auto" if find_source(source).recordings else "start",
        )
        yield DatasetScene(
            source.stem if source.is_file() else source.name, read_snapshot(source, config=config), truth, target
        )


def _sources(path: Path) -> list[Path]:
    if not path.exists():
        raise SourceNotFoundError(f"Nothing exists at {path}; give a ROS 2 bag, or a folder with one entry per scene.")
    if path.is_file() or _is_scene(path):
        return [path]
    found = [entry for entry in sorted(path.iterdir()) if (_is_scene(entry) if entry.is_dir() else _is_read(entry))]
    if not found:
        raise InputError(f"{path} holds no scene; expected ROS 2 bags, or folders with a PCD file per LiDAR.")
    return found


def _is_scene(folder: Path) -> bool:
    """Return whether a folder is a bag, or has point files of LiDARs: a file, or a folder of frames, for each."""
    if (folder / "metadata.yaml").is_file():
        return True
    entries = [entry for entry in folder.iterdir() if not entry.name.startswith(".")]
    return any(_is_read(entry, Content.CLOUD) for entry in entries if entry.is_file())


def _is_read(file: Path, content: Content = Content.RECORDING) -> bool:
    named = named_format(file)
    return named is not None and named.content is content
