# SPDX-License-Identifier: Apache-2.0
"""The stitched cloud, read by other libraries."""

from __future__ import annotations

import shutil
from pathlib import Path

import laspy
import numpy as np
import pytest

from multilica.errors import SourceNotFoundError, UnreadableSourceError, UsageError
from multilica.exports import CLOUD_FORMATS, export_run
from multilica.ingest import read_snapshot
from multilica.registration.lazy_open3d import o3d
from multilica.sinks.drawing import distinct_colours
from multilica.sinks.files.result_files import ResultFiles
from multilica.sinks.mcap.result_mcap import ResultMcap
from tests.sinks.made_events import LIDARS, TRUTH, UNPLACED, made_events


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that places all LiDARs but one."""
    folder = tmp_path_factory.mktemp("run")
    with ResultMcap(folder / "result.mcap") as mcap:
        files = ResultFiles(folder)
        for event in made_events("partial"):
            mcap(event)
            files(event)
    return folder


def expected(run: Path) -> tuple[np.ndarray, np.ndarray]:
    clouds = read_snapshot(run / "result.mcap")
    colours = distinct_colours(LIDARS)
    placed = [name for name in LIDARS if name != UNPLACED]
    points = [TRUTH[name].apply(clouds[name].points_m) for name in placed]
    return np.concatenate(points), np.concatenate(
        [np.tile(colours[name], (len(cloud), 1)) for name, cloud in zip(placed, points, strict=True)]
    )


@pytest.mark.parametrize("kind", ["pcd", "ply"])
def test_open3d_reads_points_and_colours(run: Path, tmp_path: Path, kind: str) -> None:
    done = export_run(run, tmp_path / f"all.{kind}", kind)
    assert (done.base, done.missing) == ("top", {UNPLACED: "not_placed"})
    cloud = o3d.io.read_point_cloud(str(done.path))
    points_m, colours = expected(run)
    np.testing.assert_allclose(np.asarray(cloud.points), points_m, rtol=0, atol=1e-5)
    np.testing.assert_array_equal(np.round(255 * np.asarray(cloud.colors)), colours)


def test_laspy_reads_points_and_colours(run: Path, tmp_path: Path) -> None:
    with laspy.open(export_run(run, tmp_path / "all.las", "las").path) as file:
        las = file.read()
    points_m, colours = expected(run)
    np.testing.assert_allclose(las.xyz, points_m, rtol=0, atol=6e-5)
    np.testing.assert_array_equal(np.column_stack([las.red, las.green, las.blue]) // 257, colours)
    assert (las.header.point_format.id, str(las.header.version)) == (2, "1.2")
    assert set(las.point_source_id) == {LIDARS.index(name) + 1 for name in LIDARS if name != UNPLACED}


@pytest.mark.parametrize("kind", CLOUD_FORMATS)
def test_multilica_reads_its_clouds(run: Path, tmp_path: Path, kind: str) -> None:
    export_run(run, tmp_path / f"all.{kind}", kind, base="map")
    found = read_snapshot([tmp_path / f"all.{kind}"])["all"].points_m
    np.testing.assert_allclose(found, expected(run)[0], rtol=0, atol=1e-4)


def test_another_base_moves_the_cloud(run: Path, tmp_path: Path) -> None:
    done = export_run(run / "result.mcap", tmp_path / "all.ply", "ply", base="front left/1")
    points_m = np.asarray(o3d.io.read_point_cloud(str(done.path)).points)
    np.testing.assert_allclose(TRUTH["front left/1"].apply(points_m), expected(run)[0], rtol=0, atol=2e-5)


def test_a_run_without_clouds_is_refused(run: Path, tmp_path: Path) -> None:
    shutil.copy(run / "result.json", tmp_path)
    with pytest.raises(SourceNotFoundError, match=r"has no result\.mcap, which holds the clouds"):
        export_run(tmp_path, tmp_path / "all.ply", "ply")
    (tmp_path / "result.mcap").write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(UnreadableSourceError):
        export_run(tmp_path, tmp_path / "all.ply", "ply")
    with pytest.raises(UsageError, match=r"a name that ends in \.las"):
        export_run(run, tmp_path / "all.laz", "las")
    assert {path.name for path in tmp_path.iterdir()} == {"result.json", "result.mcap"}
