# SPDX-License-Identifier: Apache-2.0
"""Point files and archives that are valid, yet not as most are."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zstandard

from multilica.config import IngestConfig
from multilica.errors import UnreadableSourceError
from multilica.ingest import inspect_source, read_snapshot
from multilica.ingest.plausibility import plausibility_notes
from multilica.snapshot import LidarScans, Scan, Snapshot
from tests.ingest.support.recording_writers import assert_same_points, make_snapshot, write_mcap

TURN = np.linspace(0.0, 2 * np.pi, 1200)
WALLS_M = np.stack([9.0 * np.cos(TURN), 6.0 * np.sin(TURN), 0.1 * np.sin(9 * TURN)], axis=1).astype(np.float32)


@pytest.mark.parametrize("columns", [3, 5, 6])
def test_float32_files_of_another_layout_are_refused(tmp_path: Path, columns: int) -> None:
    table = np.zeros((len(WALLS_M), 6), np.float32)
    table[:, :3], table[:, 3], table[:, 4] = WALLS_M, np.arange(len(WALLS_M)) % 200, np.arange(len(WALLS_M)) % 32
    table[:, :columns].tofile(tmp_path / "a.bin")
    with pytest.raises(UnreadableSourceError, match=f"holds points of {columns} float32; expected 4 with x, y, z"):
        read_snapshot(tmp_path / "a.bin")
    table[:, :4].tofile(tmp_path / "a.bin")
    np.testing.assert_array_equal(read_snapshot(tmp_path / "a.bin").lidars[0].points_m, WALLS_M)


def test_links_to_nothing_are_told_and_refused_if_strict(tmp_path: Path) -> None:
    folder = tmp_path / "scans"
    (folder / "rear").mkdir(parents=True)
    np.save(folder / "front.npy", WALLS_M)
    np.save(folder / "rear" / "0001.npy", WALLS_M + 1.0)
    (folder / "good.npy").symlink_to("front.npy")
    (folder / "readme.txt").symlink_to("nowhere")
    assert read_snapshot(folder, config=IngestConfig(strict=True)).names == ("front", "good", "rear")
    (folder / "top.npy").symlink_to("nowhere.npy")
    (folder / "left").symlink_to("nowhere")
    (folder / "rear" / "0002.npy").symlink_to("nowhere.npy")
    told = "scans/left, scans/top.npy, scans/rear/0002.npy are links to nothing, and left out."
    assert told in read_snapshot(folder).notes
    with pytest.raises(UnreadableSourceError, match=r"scans is refused, as ingest\.strict is set: .*scans/left, "):
        read_snapshot(folder, config=IngestConfig(strict=True))
    assert "is refused, as ingest.strict" in inspect_source(folder, config=IngestConfig(strict=True)).objection
    assert inspect_source(folder).objection == ""


@pytest.mark.parametrize("name", ["ring", "channel", "line", "laser_id"])
def test_rings_of_numpy_files_by_any_name(tmp_path: Path, name: str) -> None:
    table = np.zeros(len(WALLS_M), [*((axis, "f4") for axis in "xyz"), (name, "u2")])
    table["x"], table["y"], table["z"] = WALLS_M.T
    table[name] = np.arange(len(WALLS_M)) % 16
    np.save(tmp_path / "a.npy", table)
    np.testing.assert_array_equal(read_snapshot(tmp_path / "a.npy").lidars[0].scans[0].rings, table[name])


@pytest.mark.parametrize("skipped", [b"", struct.pack("<III", 0x184D2A5C, 4, 100)])
def test_zstd_files_of_several_frames(tmp_path: Path, skipped: bytes) -> None:
    snapshot = make_snapshot(frames=6, points=2000)
    write_mcap(snapshot, tmp_path / "a.mcap")
    whole, pack = (tmp_path / "a.mcap").read_bytes(), zstandard.ZstdCompressor().compress
    parts = [pack(whole[start : start + 50_000]) for start in range(0, len(whole), 50_000)]
    assert len(parts) > 2
    (tmp_path / "b.mcap.zst").write_bytes(b"".join(skipped + part for part in parts))
    found = read_snapshot(tmp_path / "b.mcap.zst")
    assert found.notes == ()
    assert_same_points(found, snapshot)


def test_zeros_of_lost_beams_hide_nothing(tmp_path: Path) -> None:
    lidar = make_snapshot(lidars=1, frames=1, points=400).lidars[0]
    far = Scan(lidar.scans[0].points_m * np.float32(1000.0), lidar.scans[0].stamp_ns)
    with_zeros = np.concatenate([far.points_m, np.zeros((900, 3), np.float32)])
    (note,) = plausibility_notes([LidarScans("a", (Scan(with_zeros, 0),))])
    assert "they may be in millimetres or centimetres; expected metres" in note
    scan = Scan(with_zeros, far.stamp_ns, np.zeros(len(with_zeros), np.float32))
    write_mcap(Snapshot((replace(lidar, scans=(scan,)),)), tmp_path / "a.mcap")
    (cloud,) = inspect_source(tmp_path / "a.mcap").clouds
    assert cloud.points_median == 400
    assert cloud.range_median_m == pytest.approx(np.median(np.linalg.norm(far.points_m, axis=1)))


@pytest.mark.parametrize(("viewpoint", "is_told"), [("0 0 0 1 0 0 0", False), ("1 2 3 1 0 0 0", True)])
def test_a_viewpoint_is_told(tmp_path: Path, viewpoint: str, *, is_told: bool) -> None:
    fields = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\n"
    (tmp_path / "a.pcd").write_text(f"{fields}VIEWPOINT {viewpoint}\nPOINTS 1\nDATA ascii\n1 2 3\n")
    snapshot = read_snapshot(tmp_path / "a.pcd")
    assert snapshot.lidars[0].points_m.tolist() == [[1.0, 2.0, 3.0]]
    assert any("VIEWPOINT" in note for note in snapshot.notes) == is_told
