# SPDX-License-Identifier: Apache-2.0
"""Logs of one vehicle that several workers treat ahead, and that are decided in order."""

from concurrent.futures import Future
from dataclasses import replace

import pytest

from multilica.checks import RigTolerances
from multilica.extrinsics import Extrinsics
from multilica.fleet.plan import QueuedLog
from multilica.fleet.store.store import open_store
from multilica.fleet.tasks import run_task
from multilica.fleet.tasks.guard import failed_row
from multilica.fleet.vehicle_chain import VehicleChain
from multilica.geometry import RigidTransform
from tests.fleet.support.counted_tasks import Tasks, run, table, write_manifest
from tests.fleet.support.requests import DAY_NS, START_NS, request

ONE = {"v1": 9}


@pytest.fixture
def manifest(tmp_path):
    return write_manifest(tmp_path / "logs.csv", ONE)


@pytest.mark.slow
@pytest.mark.parametrize("failing", [(), ("s3://logs/v1/4.mcap",)])
def test_one_vehicle_uses_all_workers_with_the_same_tables(failing, tmp_path, manifest):
    alone = open_store(tmp_path / "alone", create=True)
    outcome, events = run(manifest, alone, one := Tasks(failing=failing))
    assert one.most == 1
    assert outcome.states == {"calibrated": 2, "verified": 6 - len(failing), "duplicate": 1} | (
        {"failed": 1} if failing else {}
    )
    for attempt in range(3):
        store = open_store(tmp_path / f"together-{attempt}", create=True)
        _, others = run(manifest, store, tasks := Tasks(failing=failing, pause_s=0.01), workers=3)
        assert tasks.most == 3
        assert [row.source for row in others[1:]] == [row.source for row in events[1:]]
        assert table(store) == table(alone)
        assert table(store, "lidars") == table(alone, "lidars")
        assert sorted(path for path, _ in store.files("")) == sorted(path for path, _ in alone.files(""))


def test_finished_logs_keep_their_place(tmp_path, manifest):
    """The poses that a finished log gave hold for all logs behind it."""
    whole, store = (open_store(tmp_path / name, create=True) for name in ("whole", "store"))
    run(manifest, whole, Tasks())
    run(manifest, store, Tasks())
    for path in [path for path in store.parts("logs") if "month=2026-02" not in path]:
        store.remove(path)
    _, events = run(manifest, store, tasks := Tasks(pause_s=0.01), workers=3)
    assert len(events) - 1 == len(tasks.done) == 7
    assert table(store) == table(whole)


class Chain:
    """A chain of verified logs whose tasks end when they are told to."""

    def __init__(self, folder):
        self.store = open_store(folder / "store", create=True)
        logs = (
            QueuedLog(f"/{day}.mcap", f"{day}.mcap", 1, "f", "v1", START_NS + day * DAY_NS, key=f"{day:032d}")
            for day in range(6)
        )
        self.chain = VehicleChain(logs, self.store, lambda log, reference: self._task(folder, log, reference))

    def _task(self, folder, log, reference):
        known = {"key": log.key, "time_ns": log.time_ns, "store": self.store.address, "reference": reference}
        return request(folder, log.source, **known)

    def start(self, task=None):
        task, future = task or self.chain.next_task(), Future()
        self.chain.add(task, future)
        return task, future

    def end(self, started, reference=None, **changes):
        """End a task with the poses that it was given, or others; return what is decided."""
        task, future = started
        known = {"state": "verified", "calibration": reference or task.reference, "source_sha256": task.key}
        future.set_result(replace(task.row(), **(known | changes)))
        return [row.source for row in self.chain.decide()]


@pytest.fixture
def chain(tmp_path):
    made = Chain(tmp_path)
    assert made.end(made.start(), "poses", state="calibrated") == ["0.mcap"]
    assert not made.chain.may_go_ahead(4)  # the poses have just changed
    assert made.end(made.start()) == ["1.mcap"]
    return made


def test_logs_ahead_wait_for_their_turn(chain):
    first = chain.start()
    assert chain.chain.may_go_ahead(2)
    second = chain.start()
    assert not chain.chain.may_go_ahead(2)
    assert [task.ahead for task, _ in (first, second)] == [False, True]
    assert chain.end(second) == []
    assert chain.end(first) == ["2.mcap", "3.mcap"]
    assert [path.rpartition("/")[2] for path in chain.store.parts("logs")] == [f"{3:032d}.parquet"]


@pytest.mark.parametrize("change", ["poses", "failure"])
def test_a_log_ahead_is_treated_again_if_it_does_not_count(change, chain):
    first, second = chain.start(), chain.start()
    task = second[0]
    files = chain.store.run_folder(task.vehicle, task.time_ns, task.key)
    chain.store.write(f"{files}/recording.rrd", b"of poses that no longer hold")
    state = "calibrated" if change == "poses" else "failed"
    assert chain.end(second, state=state) == []
    assert chain.end(first, "others" if change == "poses" else None) == ["2.mcap"]
    again = chain.chain.task_again()
    assert (again.source, again.ahead) == ("3.mcap", False)
    assert again.reference == ("others" if change == "poses" else "poses")
    assert bool(list(chain.store.files(files))) is (change == "failure")
    assert list(chain.store.parts("logs")) == []
    assert chain.chain.task_again() is None
    assert chain.end(chain.start(again)) == ["3.mcap"]


def test_a_copy_ahead_is_one_of_the_log_before(chain):
    first, second = chain.start(), chain.start()
    chain.store.first_with("same", "v1", "c", "2.mcap")
    task = second[0]
    place = f"{chain.store.run_folder(task.vehicle, task.time_ns, task.key)}/reference.toml"
    chain.store.write(place, b"poses")
    assert chain.end(second, place, state="calibrated", source_sha256="same") == []
    chain.store.write_log(replace(first[0].row(), state="verified"))
    chain.end(first, source_sha256="same")
    with pytest.raises(StopIteration):
        next(chain.store.files("runs"))
    _, row = sorted(chain.store.dataset("logs").to_table().to_pylist(), key=lambda each: each["source"])
    assert (row["source"], row["state"], row["calibration"]) == ("3.mcap", "duplicate", "poses")
    assert row["reason_text"] == "the same bytes as 2.mcap"


def test_a_log_that_fails_ahead_has_no_row(tmp_path, monkeypatch):
    from multilica.fleet.tasks import guard

    task = request(tmp_path, "a.mcap", ahead=True)
    monkeypatch.setattr(guard, "_tried", lambda *_: (guard.LogTaskFailure("bug", "a text"), 1))
    row = guard.run_guarded(task, guard.LogTaskLimits())
    assert row.reason_text == failed_row(task, "bug", "a text").reason_text
    assert list(open_store(tmp_path / "store", create=False).parts("logs")) == []


@pytest.mark.parametrize(
    ("target", "front_m", "holds"),
    [("top", 0.0, True), ("top", 0.02, True), ("top", 0.04, False), ("front", 0.02, True), ("front", 0.04, False)],
)
def test_poses_that_agree_go_on_to_hold(target, front_m, holds):
    known = Extrinsics("top", {"front": pose("front", 2.0), "rear": pose("rear", -3.0)})
    found = Extrinsics("top", {"front": pose("front", 2.0 + front_m)})
    if target == "front":
        found = Extrinsics("front", {"top": found.between("front", "top")})
    assert run_task._agree(found, known, RigTolerances()) is holds
    new = Extrinsics("top", {"left": pose("left", 1.0)})
    assert not run_task._agree(new, known, RigTolerances())


def pose(lidar, x_m):
    return RigidTransform.from_xyz_rpy("top", lidar, [x_m, 0.0, 0.0], [0.0, 0.0, 0.5])
