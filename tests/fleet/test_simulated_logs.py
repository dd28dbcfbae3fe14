# SPDX-License-Identifier: Apache-2.0
"""The files of a simulated fleet."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from multilica.errors import InputError, UsageError, WorkerDiedError
from multilica.fleet.simulated_logs import FLEET_TRUTH_SCHEMA, TRUTH_NAME, fleet_truth, write_fleet
from multilica.geometry import RigidTransform
from multilica.ingest import read_snapshot
from multilica.simulate import FleetPlan, PlannedLog, plan_fleet

LIDARS = ("front", "left", "rear", "right")
PLAN = plan_fleet(3, 13, 4, frames=1, keep_every=60, jumps=0, creeps=1, dead=1, broken=5, duplicates=1)
FAULTS = ("truncated", "zeros", "empty", "text", "lfs_pointer")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("fleet") / "logs"
    write_fleet(PLAN, out, workers=1)
    return out


def files_below(folder: Path) -> dict[str, bytes]:
    return {
        each.relative_to(folder).as_posix(): each.read_bytes() for each in sorted(folder.rglob("*")) if each.is_file()
    }


def intact(plan: FleetPlan) -> list[PlannedLog]:
    return [log for log in plan.logs if not log.fault]


def test_the_small_fleet_has_all_formats_and_faults() -> None:
    assert {log.format for log in intact(PLAN)} == {"snapshot", "ros2_mcap", "ros2_bag", "ros1_bag"}
    assert {log.fault for log in PLAN.logs if log.fault} == {*FAULTS}
    assert {event.kind for event in PLAN.events} == {"creep", "dead"}


@pytest.mark.in_turn
@pytest.mark.slow
@pytest.mark.parametrize("log", intact(PLAN), ids=lambda log: log.path)
def test_intact_logs_are_read(log: PlannedLog, folder: Path) -> None:
    snapshot = read_snapshot(folder / log.path)
    alive = {lidar.name for lidar in snapshot.lidars if lidar.points_count > 300}
    assert alive == {*LIDARS} - {*log.dead}
    assert {scan.stamp_ns for name in alive for scan in snapshot[name].scans} == {log.time_ns}


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_broken_logs_are_refused(fault: str, folder: Path) -> None:
    (log,) = (log for log in PLAN.logs if log.fault == fault)
    with pytest.raises(InputError) as refusal:
        read_snapshot(folder / log.path)
    assert Path(log.path).name in str(refusal.value)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 9])
def test_nothing_is_read_of_a_cut_log_of_usual_size(seed: int, tmp_path: Path) -> None:
    plan = plan_fleet(1, 1, seed, broken=1)
    write_fleet(plan, tmp_path / "logs", workers=1)
    (log,) = plan.logs
    assert (log.fault, log.format) == ("truncated", "ros2_mcap" if seed else "snapshot")
    with pytest.raises(InputError):
        read_snapshot(tmp_path / "logs" / log.path)


@pytest.mark.slow
def test_a_duplicate_has_the_same_bytes(folder: Path) -> None:
    (copy,) = (log for log in PLAN.logs if log.duplicate_of)
    assert copy.path != copy.duplicate_of
    assert Path(copy.path).parent == Path(copy.duplicate_of).parent
    assert (folder / copy.path).read_bytes() == (folder / copy.duplicate_of).read_bytes()


@pytest.mark.in_turn
@pytest.mark.slow
def test_any_number_of_workers_gives_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    seen: list[str] = []
    truth = write_fleet(PLAN, tmp_path / "again", workers=2, observe=lambda log: seen.append(log.path))
    assert truth == tmp_path / "again" / TRUTH_NAME
    assert files_below(tmp_path / "again") == files_below(folder)
    assert sorted(seen) == sorted(log.path for log in PLAN.logs)


@pytest.mark.slow
def test_the_truth_names_every_log_and_event(folder: Path) -> None:
    truth = json.loads((folder / TRUTH_NAME).read_text(encoding="utf-8"))
    assert truth == fleet_truth(PLAN)
    assert truth["schema"] == FLEET_TRUTH_SCHEMA
    assert truth["vehicles"] == ["v01", "v02", "v03"]
    present = {path for path in files_below(folder) if path != TRUTH_NAME}
    assert {entry["path"] for entry in truth["logs"]} == {
        path if Path(path).parent.name in truth["vehicles"] else Path(path).parent.as_posix() for path in present
    }
    assert {entry["broken"] for entry in truth["logs"]} == {None, *FAULTS}
    for entry in truth["logs"]:
        assert set(entry["T_target_lidar"]) == {*LIDARS}
        assert entry["time"].startswith(Path(entry["path"]).name[:10])
    for event in truth["events"]:
        first = next(entry for entry in truth["logs"] if entry["path"] == event["first_log"])
        assert (first["vehicle"], first["time"]) == (event["vehicle"], event["first_log_time"])
        assert (event["shift_m"] is None) == (event["kind"] == "dead")


def test_poses_in_the_truth_are_those_of_the_plan() -> None:
    log = next(log for log in PLAN.logs if log.moved)
    entry = next(each for each in fleet_truth(PLAN)["logs"] if each["path"] == log.path)
    for name, values in entry["T_target_lidar"].items():
        xyz_m, xyzw = ([values[key] for key in keys] for keys in (("x_m", "y_m", "z_m"), ("qx", "qy", "qz", "qw")))
        pose = RigidTransform.from_xyz_quaternion("left", name, xyz_m, xyzw)
        np.testing.assert_allclose(pose.matrix, PLAN.true_poses(log)[name].matrix, atol=1e-12)
    assert entry["T_target_lidar"]["left"]["qw"] == 1.0


def test_a_folder_in_use_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    for out in (tmp_path, tmp_path / "notes.txt"):
        with pytest.raises(UsageError, match="exists already"):
            write_fleet(PLAN, out)
    assert [each.name for each in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.slow
def test_without_an_end_there_is_no_truth(tmp_path: Path) -> None:
    def stop(log: PlannedLog) -> None:
        raise WorkerDiedError(log.path)

    with pytest.raises(WorkerDiedError):
        write_fleet(PLAN, tmp_path / "logs", workers=1, observe=stop)
    assert not (tmp_path / "logs" / TRUTH_NAME).exists()
    assert not list((tmp_path / "logs").rglob("*.tmp"))
