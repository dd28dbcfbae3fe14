# SPDX-License-Identifier: Apache-2.0
"""Damaged recordings give what lies before the damage, or one sentence."""

from __future__ import annotations

import resource
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from multilica.config import IngestConfig
from multilica.errors import MultilicaError, UnreadableSourceError
from multilica.geometry import RigidTransform
from multilica.ingest import inspect_source, read_snapshot
from multilica.snapshot import Snapshot
from tests.ingest.support.recording_writers import (
    PERIOD_NS,
    START_NS,
    assert_same_points,
    cloud_message,
    make_snapshot,
    ros2_types,
    write_mcap,
    write_ros1_bag,
    write_ros2_bag,
)

FRAMES = 6


def test_damage_is_told_if_the_window_begins_within_it(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write_mcap(make_snapshot(frames=20, points=500), path, chunk_size=60_000, compression=CompressionType.NONE)
    with path.open("rb") as file:
        chunks = make_reader(file).get_summary().chunk_indexes
    damaged = chunks[1]
    data = bytearray(path.read_bytes())
    data[damaged.chunk_start_offset + damaged.chunk_length // 2] ^= 0xFF
    path.write_bytes(data)
    assert damaged.message_end_time - damaged.message_start_time >= 2 * PERIOD_NS
    start_s = (damaged.message_start_time - START_NS + 1.5 * PERIOD_NS) / 1e9
    found = read_snapshot(path, config=IngestConfig(frames=3, start_s=start_s))
    assert any("has lost scans in 1 place" in note for note in found.notes)
    with pytest.raises(UnreadableSourceError, match=r"ingest\.strict is set"):
        read_snapshot(path, config=IngestConfig(frames=3, start_s=start_s, strict=True))


def _bare(storage: StoragePlugin) -> Callable[[Snapshot, Path], None]:
    def write(snapshot: Snapshot, path: Path) -> None:
        write_ros2_bag(snapshot, path.with_name("bag"), storage)
        next(path.with_name("bag").glob(f"*{path.suffix}")).rename(path)

    return write


WRITERS: dict[str, Callable[[Snapshot, Path], None]] = {
    "zstd.mcap": write_mcap,
    "plain.mcap": lambda snapshot, path: write_mcap(snapshot, path, compression=CompressionType.NONE),
    "lz4.mcap": lambda snapshot, path: write_mcap(snapshot, path, compression=CompressionType.LZ4),
    "unchunked.mcap": lambda snapshot, path: write_mcap(snapshot, path, chunked=False, indexed=False),
    "ros2.mcap": _bare(StoragePlugin.MCAP),
    "ros2.db3": _bare(StoragePlugin.SQLITE3),
    "plain.bag": write_ros1_bag,
    "lz4.bag": lambda snapshot, path: write_ros1_bag(snapshot, path, Ros1Writer.CompressionFormat.LZ4),
    "bz2.bag": lambda snapshot, path: write_ros1_bag(snapshot, path, Ros1Writer.CompressionFormat.BZ2),
}
ONE_BLOCK = {"ros2.mcap", "lz4.bag", "bz2.bag"}
"""Written as one compressed block, of which nothing can be read before it is whole."""


@pytest.fixture(params=WRITERS)
def recording(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / request.param
    WRITERS[request.param](make_snapshot(frames=FRAMES), path)
    return path


def read_or_refuse(path: Path) -> Snapshot | None:
    """A snapshot of finite points, or a MultilicaError of one line; nothing else may happen."""
    sentence, snapshot = "", Snapshot(())
    try:
        snapshot = read_snapshot(path)
    except MultilicaError as error:
        sentence = str(error)
    assert "\n" not in sentence
    if sentence:
        return None
    for lidar in snapshot.lidars:
        assert lidar.scans
        assert all(np.isfinite(scan.points_m).all() for scan in lidar.scans)
    return snapshot


def assert_prefix(found: Snapshot, whole: Snapshot) -> None:
    for lidar in found.lidars:
        for scan, expected in zip(lidar.scans, whole[lidar.name].scans, strict=False):
            np.testing.assert_array_equal(scan.points_m, expected.points_m)


def test_cut_off_anywhere(recording: Path, capfd: pytest.CaptureFixture[str]) -> None:
    whole, content = read_snapshot(recording), recording.read_bytes()
    recovered = []
    for size in sorted({*range(0, 60, 7), *range(60, len(content), len(content) // 60)}):
        recording.write_bytes(content[:size])
        found = read_or_refuse(recording)
        if found is not None:
            assert_prefix(found, whole)
            recovered.append(sum(len(lidar.scans) for lidar in found.lidars))
            assert any("damaged" in note or " scans, then " in note for note in found.notes)
    assert recovered == sorted(recovered)
    assert recovered[-1] >= 2 * FRAMES - 2
    if recording.name not in ONE_BLOCK:
        assert 0 < recovered[0] < recovered[-1]
    assert capfd.readouterr() == ("", "")


@pytest.mark.in_turn
@pytest.mark.slow
def test_bytes_changed_anywhere(recording: Path, capfd: pytest.CaptureFixture[str]) -> None:
    content = recording.read_bytes()
    generator = np.random.default_rng(7)
    for number in range(120):
        changed = bytearray(content)
        for place in generator.integers(len(changed), size=(1, 2, 30)[number % 3]):
            changed[place : place + 4] = [b"\xff" * 4, b"\0" * 4, generator.bytes(4)][generator.integers(3)]
        recording.write_bytes(changed[: len(content)])
        read_or_refuse(recording)
        with suppress(MultilicaError):
            inspect_source(recording)
    assert capfd.readouterr() == ("", "")


def test_what_was_recovered_is_said(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write_mcap(make_snapshot(lidars=1, frames=20, points=500), path, chunk_size=1)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 6 // 10])
    snapshot = read_snapshot(path, config=IngestConfig(frames=20))
    taken = len(snapshot.lidars[0].scans)
    assert 5 < taken < 19
    assert snapshot.notes == (f"'/lidar_0/points': {taken} of 20 scans, then the file ends too early.",)
    few = read_snapshot(path, config=IngestConfig(frames=3))
    assert len(few.lidars[0].scans) == 3
    assert few.notes == (f"{path.name} is damaged: the file ends too early; all wanted scans lie before that.",)


@pytest.mark.parametrize("compression", list(CompressionType))
def test_the_beginning_of_a_chunk_that_was_cut_off_is_used(tmp_path: Path, compression: CompressionType) -> None:
    whole = make_snapshot(lidars=1, frames=100, points=500)
    path = tmp_path / "a.mcap"
    write_mcap(whole, path, compression=compression, chunk_size=1 << 30)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 8 // 10])
    found = read_snapshot(path, config=IngestConfig(frames=100))
    assert 60 < len(found.lidars[0].scans) < 85
    assert_prefix(found, whole)
    assert any("of 100 scans, then the file ends too early" in note for note in found.notes)


@pytest.mark.in_turn
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "points"), [("plain.mcap", 500), ("zstd.mcap", 500), ("lz4.mcap", 500), ("bz2.bag", 42_000)]
)
def test_a_damaged_chunk_costs_what_lies_in_it(tmp_path: Path, name: str, points: int) -> None:
    """Each scan is a chunk of its own: `rosbags` ends one after a megabyte."""
    whole = make_snapshot(lidars=1, frames=8, points=points)
    path = tmp_path / name
    WRITERS[name](whole, path)
    content = bytearray(path.read_bytes())
    content[len(content) * 7 // 16] ^= 1
    path.write_bytes(content)
    snapshot = read_snapshot(path, config=IngestConfig(frames=8))
    stamps = [scan.stamp_ns for scan in snapshot.lidars[0].scans]
    assert len(stamps) == 7
    assert {stamps[0], stamps[-1]} == {whole.lidars[0].scans[0].stamp_ns, whole.lidars[0].scans[-1].stamp_ns}
    for scan in snapshot.lidars[0].scans:
        (expected,) = (each for each in whole.lidars[0].scans if each.stamp_ns == scan.stamp_ns)
        np.testing.assert_array_equal(scan.points_m, expected.points_m)
    (note,) = snapshot.notes
    assert note.startswith("'/lidar_0/points' has lost scans in 1 place: ")
    assert " lies where the file is damaged: " in note
    with pytest.raises(UnreadableSourceError, match=r"refused, as ingest\.strict is set: '/lidar_0/points' has lost"):
        read_snapshot(path, config=IngestConfig(frames=8, strict=True))


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_static_transforms_in_a_damaged_chunk_are_told_as_lost(tmp_path: Path, encoding: str) -> None:
    pose = RigidTransform.from_xyz_rpy("base", "lidar_1", [1.0, 2.0, 3.0], [0.1, 0.2, 0.3])
    path = tmp_path / "a.mcap"
    whole = Snapshot(make_snapshot().lidars, static_transforms=(pose,))
    write_mcap(whole, path, encoding=encoding, compression=CompressionType.NONE, chunk_size=1)
    content = bytearray(path.read_bytes())
    content[content.index(b"base")] ^= 1
    path.write_bytes(content)
    snapshot = read_snapshot(path)
    assert_same_points(snapshot, whole)
    (note,) = snapshot.notes
    assert note.startswith("A message on '/tf_static' was left out: it lies where the file is damaged: a checksum")


def test_a_lidar_without_scans_does_not_affect_the_others(tmp_path: Path) -> None:
    whole = make_snapshot(frames=1)
    path = tmp_path / "a.mcap"
    write_mcap(whole, path, compression=CompressionType.NONE)
    content = bytearray(path.read_bytes())
    for lidar, left in ((1, ("lidar_0",)), (0, ())):
        points = cloud_message(ros2_types(), whole.lidars[lidar].scans[0], "").data.tobytes()
        content[content.index(points[100:200])] ^= 1
        path.write_bytes(content)
        if left:
            snapshot = read_snapshot(path)
            assert snapshot.names == left
            assert any("'/lidar_1/points' has lost scans in 1 place: " in note for note in snapshot.notes)
        else:
            with pytest.raises(UnreadableSourceError, match="where the file is damaged: a checksum does not match"):
                read_snapshot(path)


def test_what_a_killed_recorder_of_ros1_leaves(tmp_path: Path) -> None:
    whole = make_snapshot(frames=FRAMES)
    write_ros1_bag(whole, tmp_path / "drive.bag")
    content = (tmp_path / "drive.bag").read_bytes()
    (tmp_path / "drive.bag").unlink()
    left = tmp_path / "drive.bag.active"
    left.write_bytes(content[: len(content) * 3 // 4])
    for source in (left, tmp_path):
        found = read_snapshot(source)
        assert_prefix(found, whole)
        assert all("scans, then the file ends too early" in note for note in found.notes)


def test_nothing_to_recover_is_an_error(recording: Path) -> None:
    recording.write_bytes(recording.read_bytes()[:100])
    with pytest.raises(UnreadableSourceError, match=r"is damaged: .*\.$"):
        read_snapshot(recording)


def test_a_bag_packed_as_a_whole_and_cut_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    unpacked = tmp_path / "unpacked"
    unpacked.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(unpacked))
    write_ros2_bag(make_snapshot(frames=FRAMES), tmp_path / "bag", compression=CompressionMode.FILE)
    (packed,) = (tmp_path / "bag").glob("*.zstd")
    content = packed.read_bytes()
    for size in range(30, len(content), len(content) // 20):
        packed.write_bytes(content[:size])
        read_or_refuse(tmp_path / "bag")
    packed.write_bytes(b"\x28\xb5\x2f\xfd" + b"\xff" * 50)
    with pytest.raises(UnreadableSourceError, match="compressed data cannot be unpacked"):
        read_snapshot(tmp_path / "bag")
    assert not list(unpacked.iterdir())


def test_memory_is_bounded_whatever_a_header_claims(tmp_path: Path) -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    path = tmp_path / "a.mcap"
    write_mcap(make_snapshot(lidars=1, frames=1), path, compression=CompressionType.NONE, chunked=False, indexed=False)
    content = path.read_bytes()
    width = (50).to_bytes(4, "little")
    place = content.index(b"lidar_0\0") + 8
    place = content.index(width, place)
    path.write_bytes(content[:place] + (400_000_000).to_bytes(4, "little") + content[place + 4 :])
    with pytest.raises(
        UnreadableSourceError, match=r"claims 400000000 x 1 points of 26 bytes, which takes 10400000000"
    ):
        read_snapshot(path)
    grown_mb = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    assert grown_mb < 100
