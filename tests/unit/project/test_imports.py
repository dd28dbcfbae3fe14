# SPDX-License-Identifier: Apache-2.0
"""Which libraries a command imports."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from multilica import read_snapshot
from tests.cli.support import write_recording

ROOT = Path(__file__).parents[3]
SAMPLE = ROOT / "recordings" / "samples" / "edgar-street.mcap"
HEAVY = {
    "open3d",
    "rerun",
    "scipy",
    "numpy",
    "mcap",
    "rosbags",
    "foxglove_schemas_protobuf",
    "small_gicp",
    "kiss_matcher",
}
PLOTS = {"dash", "plotly", "IPython"}
READ_SAMPLE = f"from multilica import read_snapshot; snapshot = read_snapshot({str(SAMPLE)!r})"
SHOW_POINT = """
from multilica.registration.lazy_open3d import o3d
cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector([[1.0, 2.0, 3.0]]))
"""


def imported_by(code: str) -> set[str]:
    listing = "\nimport sys; print(' '.join(sys.modules))"
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'cli'}"}
    outcome = subprocess.run(
        [sys.executable, "-c", code + listing], capture_output=True, text=True, check=True, cwd=ROOT, env=environment
    )
    return {name.partition(".")[0] for name in outcome.stdout.splitlines()[-1].split()}


def thinned_sample(folder: Path) -> Path:
    """A recording of a frame of two LiDARs of the sample."""
    points = {lidar.name: lidar.scans[0].points_m[::2] for lidar in read_snapshot(SAMPLE).lidars[:2]}
    return write_recording(folder / "thinned.mcap", points)


def test_importing_the_package_stays_light() -> None:
    assert imported_by("import multilica") & HEAVY == set()


@pytest.mark.parametrize("arguments", [["--help"], ["calibrate", "--help"], ["--version"], []])
def test_help_stays_light(arguments: list[str]) -> None:
    loaded = imported_by(f"from multilica_cli.main import run; run({arguments!r})")
    assert "typer" in loaded
    assert loaded & HEAVY == set()


@pytest.mark.slow
def test_reading_takes_no_viewer_and_no_engine() -> None:
    loaded = imported_by(READ_SAMPLE)
    assert "mcap" in loaded
    assert loaded & (PLOTS | {"open3d", "small_gicp", "kiss_matcher", "rerun", "rosbags"}) == set()


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_run_until_ingest_takes_no_open3d(tmp_path: Path) -> None:
    arguments = ["calibrate", str(SAMPLE), "--out", str(tmp_path), "--until", "ingest", "--quiet"]
    loaded = imported_by(f"from multilica_cli.main import run; run({arguments!r})")
    assert "rerun" in loaded
    assert loaded & (PLOTS | {"open3d", "kiss_matcher", "rosbags"}) == set()


@pytest.mark.slow
def test_a_calibration_takes_no_open3d(tmp_path: Path) -> None:
    options = ["--out", str(tmp_path / "run"), "--until", "fine", "--workers", "1", "--quiet"]
    recording = str(thinned_sample(tmp_path))
    loaded = imported_by(f"from multilica_cli.main import run; run({['calibrate', recording, *options]!r})")
    assert "small_gicp" in loaded
    assert "open3d" not in loaded


def test_open3d_comes_without_its_plots() -> None:
    loaded = imported_by(SHOW_POINT)
    assert "open3d" in loaded
    assert loaded & PLOTS == set()


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize("before", ["", "import dash, open3d"])
def test_the_plots_of_open3d_still_work(before: str) -> None:
    plot = "for _ in range(2): print(len(o3d.visualization.get_plotly_fig([cloud]).data))"
    assert imported_by(f"{before}{SHOW_POINT}{plot}\nimport dash") >= PLOTS


@pytest.mark.slow
@pytest.mark.in_turn
def test_verify_takes_no_viewer_and_draws_no_picture(tmp_path: Path) -> None:
    arguments = ["verify", str(thinned_sample(tmp_path)), "--calibration", str(SAMPLE.with_suffix(".truth.toml"))]
    loaded = imported_by(f"from multilica_cli.main import run; run({arguments!r})")
    assert "small_gicp" in loaded
    assert loaded & (PLOTS | {"PIL", "jinja2", "rerun", "open3d", "foxglove_schemas_protobuf", "kiss_matcher"}) == set()
