# SPDX-License-Identifier: Apache-2.0
"""What a watch tells beside its lines, read by other libraries."""

from __future__ import annotations

import math
import socket
from dataclasses import replace
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families
from rosbags.typesys import Stores, get_typestore

from multilica.checks import LidarCheck, RigCheck
from multilica.errors import UsageError
from multilica.extrinsics import Extrinsics
from multilica.fleet.drift.drift import find_outages
from multilica.fleet.store.store import open_store
from multilica.geometry import RigidTransform
from multilica.results import CalibrationResult, LidarPlacement
from multilica.watch import Observation
from multilica.watch.outputs import diagnostic_message, metrics_at, rows_into
from multilica_cli.commands.watch import WatchLines
from multilica_cli.exit_codes import ExitCode
from tests.cli.support import Invoke, assert_one_sentence

TIME_NS = 1_790_000_000_500_000_000
REAR = RigidTransform.from_xyz_rpy("front", "rear", (-2.0, 0.1, 0.0), (0.0, 0.0, 3.0))


def lidar_check(name: str, verdict: str, distance_m: float | None) -> LidarCheck:
    angle_deg = None if distance_m is None else 0.5
    return LidarCheck(
        lidar=name, verdict=verdict, reason="moved", distance_m=distance_m, angle_deg=angle_deg,
        max_translation_m=0.03, max_rotation_deg=0.3,
    )  # fmt: skip


def verdict() -> Observation:
    """`rear` is 5 cm off and `top` has no pose."""
    covariance = np.diag([1e-8] * 3 + [1e-6] * 3)
    placements = (
        LidarPlacement("front", "root", "placed", RigidTransform.identity("front", "front")),
        LidarPlacement("rear", "placed", "placed", REAR, covariance=covariance),
        LidarPlacement("top", "no overlap"),
    )
    check = RigCheck(
        name="ros2://",
        root="front",
        lidars=(lidar_check("rear", "outside", 0.05), lidar_check("top", "undecided", None)),
    )
    found = CalibrationResult("front", "made up", placements)
    known = Extrinsics("front", {"rear": REAR})
    return Observation(TIME_NS, check.verdict, check.sentence, check, found, known)


def test_ros_reads_the_diagnostics() -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    message = store.deserialize_cdr(diagnostic_message(verdict()), "diagnostic_msgs/msg/DiagnosticArray")
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == divmod(TIME_NS, 10**9)
    told = {status.name: (status.level, status.message, status.hardware_id) for status in message.status}
    assert told == {
        "multilica: rig": (2, verdict().text, "rig"),
        "multilica: rear": (2, "moved", "rear"),
        "multilica: top": (1, "moved", "top"),
    }
    values = {pair.key: pair.value for pair in message.status[1].values}
    assert values == {"distance_m": "0.05", "angle_deg": "0.5", "max_translation_m": "0.03", "max_rotation_deg": "0.3"}


def test_a_look_without_a_verdict_is_a_status_of_the_rig() -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    data = diagnostic_message(Observation(-1, "moving", "The vehicle moves."))
    (status,) = store.deserialize_cdr(data, "diagnostic_msgs/msg/DiagnosticArray").status
    assert (status.level, status.message) == (3, "The vehicle moves.")


def test_each_reason_is_told_once_until_a_verdict(capsys: pytest.CaptureFixture[str]) -> None:
    tell = WatchLines(quiet=False)
    moving, missing = Observation(0, "moving", "It moves by 3 m."), Observation(0, "failed", "There is no a.toml.")
    gone, later = (Observation(0, "failed", f"Nothing answers in {after_s} s.") for after_s in (3, 4))
    for each in (gone, later, missing, moving, gone, moving, verdict(), gone):
        tell(each)
    out, err = capsys.readouterr()
    assert [line.partition(" ")[2] for line in err.splitlines()] == [
        "failed: Nothing answers in 3 s.",
        "failed: There is no a.toml.",
        "moving: It moves by 3 m.",
        "failed: Nothing answers in 3 s.",
    ]
    assert [line.split()[1] for line in out.splitlines()] == ["outside:"]


def scraped(port: int) -> dict[tuple[str, str], float]:
    with urlopen(f"http://127.0.0.1:{port}/metrics") as page:
        families = text_string_to_metric_families(page.read().decode())
    return {(each.name, "".join(each.labels.values())): each.value for family in families for each in family.samples}


def test_metrics_are_scraped() -> None:
    with socket.create_server(("", 0)) as free:
        port = free.getsockname()[1]
    tell = metrics_at(port)
    tell(Observation(TIME_NS, "moving", "The vehicle moves."))
    tell(verdict())
    found = scraped(port)
    assert found["multilica_looks_total", "moving"] == found["multilica_looks_total", "outside"] == 1.0
    assert found["multilica_looks_total", "within"] == 0.0
    assert found["multilica_last_verdict_seconds", ""] == TIME_NS / 1e9
    assert found["multilica_lidar_within", "rear"] == 0.0
    assert math.isnan(found["multilica_lidar_within", "top"])
    assert found["multilica_lidar_distance_m", "rear"] == 0.05
    assert ("multilica_lidar_distance_m", "top") not in found
    with pytest.raises(UsageError, match=f"cannot be served at port {port}"):
        metrics_at(port)


def test_verdicts_are_rows_of_a_store(tmp_path: Path) -> None:
    store = open_store(tmp_path / "store", create=True)
    tell = rows_into(store, "bus-7", "ros2://")
    tell(Observation(TIME_NS, "failed", "gone"))
    assert list(store.parts("logs")) == []
    tell(verdict())
    (log,) = store.dataset("logs").to_table().to_pylist()
    assert (log["vehicle"], log["source"], log["state"], log["lidars"], log["placed"]) == (
        "bus-7", "ros2://", "verified", 3, 2
    )  # fmt: skip
    assert log["time"].timestamp() == TIME_NS / 1e9
    rows = {row["lidar"]: row for row in store.dataset("lidars").to_table().to_pylist()}
    np.testing.assert_allclose([rows["rear"][axis] for axis in ("x_m", "y_m", "z_m")], REAR.xyz_m)
    assert rows["rear"]["sigma_mm"] == pytest.approx(1.0)
    assert (rows["top"]["status"], rows["top"]["reason_text"], rows["top"]["x_m"]) == ("not_placed", "no overlap", None)


def rows_of(tmp_path: Path, *observations: Observation) -> dict[str, dict[str, object]]:
    store = open_store(tmp_path / "store", create=True)
    for observation in observations:
        rows_into(store, "bus-7", "ros2://")(observation)
    return {row["lidar"]: row for row in store.dataset("lidars").to_table().to_pylist()}


def test_a_lidar_without_a_topic_has_a_row(tmp_path: Path) -> None:
    found = replace(verdict().found, placements=verdict().found.placements[:2])
    looks = [replace(verdict(), found=found, time_ns=TIME_NS + hour * 3_600_000_000_000) for hour in range(2)]
    row = rows_of(tmp_path, *looks)["top"]
    assert (row["status"], row["reason"], row["target"]) == ("not_placed", "no_topic", "front")
    (outage,) = find_outages(open_store(tmp_path / "store", create=False))
    assert (outage.lidar, outage.reason, outage.logs) == ("top", "no_topic", 2)


def test_poses_in_a_vehicle_frame_are_stored_relative_to_a_lidar(tmp_path: Path) -> None:
    T_base_front = RigidTransform.from_xyz_rpy("base_link", "front", (1.0, 0.0, 2.0), (0.0, 0.1, 0.5))
    known = Extrinsics("base_link", {"front": T_base_front, "rear": T_base_front @ REAR})
    rows = rows_of(tmp_path, replace(verdict(), known=known))
    assert [(name, row["target"], row["status"], row["reason"]) for name, row in sorted(rows.items())] == [
        ("front", "front", "placed", ""), ("rear", "front", "placed", ""), ("top", "front", "not_placed", "unverified")
    ]  # fmt: skip
    np.testing.assert_allclose([rows["rear"][axis] for axis in ("x_m", "y_m", "z_m")], REAR.xyz_m)


def test_lidars_that_a_watch_loses_are_found(tmp_path: Path) -> None:
    """The target is lost, and with it the poses of the others; one of these has moved far."""
    identity = RigidTransform.identity("rear", "rear")
    placements = (
        LidarPlacement("front", "no returns"),
        LidarPlacement("rear", "root", "placed", identity),
        LidarPlacement("top", "moved", contradicts_prior=True),
    )
    found = CalibrationResult("rear", "made up", placements)
    looks = [replace(verdict(), found=found, time_ns=TIME_NS + hour * 3_600_000_000_000) for hour in range(2)]
    rows_of(tmp_path, *looks)
    outages = find_outages(open_store(tmp_path / "store", create=False))
    assert [(each.lidar, each.reason, each.logs) for each in outages] == [
        ("front", "unverified", 2), ("rear", "no_target", 2), ("top", "against_prior", 2)
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("drive.mcap", "--calibration", "a.toml"), ExitCode.USAGE, "use `multilica verify`"),
        (("ros2://robot", "--calibration", "a.toml"), ExitCode.USAGE, "ROS_DOMAIN_ID"),
        (("ws://127.0.0.1:1", "--calibration", "missing.toml"), ExitCode.INPUT, "missing.toml"),
        (("ws://127.0.0.1:1", "--calibration", "a.toml", "--store", "ftp://a"), ExitCode.USAGE, "ftp://a"),
    ],
)
def test_a_watch_that_cannot_begin_is_one_sentence(
    words: tuple[str, ...], code: ExitCode, said: str, invoke: Invoke
) -> None:
    Path("a.toml").touch()
    outcome = invoke("watch", *words)
    assert_one_sentence(outcome, code)
    assert said in outcome.err
