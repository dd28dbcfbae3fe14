# SPDX-License-Identifier: Apache-2.0
import threading
from dataclasses import replace

import pytest

from multilica.checks import RigTolerances, Tolerance
from multilica.errors import SourceNotFoundError
from multilica.fleet.fleet_run import FleetOptions, run_fleet
from multilica.fleet.store.query import FAILURES, STATUS, ask
from multilica.fleet.store.store import open_store
from multilica.fleet.store.upkeep import compact_store
from multilica.fleet.tasks.guard import LogTaskLimits, failed_row
from tests.fleet.support.counted_tasks import FLEET, Tasks, run, table, write_manifest
from tests.fleet.support.made_store import add_log


@pytest.fixture
def manifest(tmp_path):
    return write_manifest(tmp_path / "logs.csv")


@pytest.mark.parametrize("workers", [1, 4])
def test_logs_run_by_time_from_the_last_accepted_poses(tmp_path, manifest, workers):
    store, tasks = open_store(tmp_path / "store", create=True), Tasks()
    outcome, events = run(manifest, store, tasks, workers=workers)
    assert (outcome.found, outcome.skipped, outcome.states) == (12, 0, {"calibrated": 6, "verified": 6})
    assert (events[0].found, events[0].skipped) == (12, 0)
    assert len(events) == 13
    for vehicle, days in FLEET.items():
        own = [row.source for row in events[1:] if row.vehicle == vehicle]
        assert own == sorted(own)
        assert len(own) == days
    with ask(store, "SELECT source, reference, calibration FROM logs WHERE vehicle = 'v1' ORDER BY time") as answer:
        (_, none, first), (_, one, _), (moved, two, second), (_, three, _), (_, four, _) = answer.rows()
    assert none == ""
    assert one == two == first
    assert "moved" in moved
    assert three == four == second != first


def test_newest_first_goes_back_in_time(tmp_path, manifest):
    store, tasks = open_store(tmp_path / "store", create=True), Tasks()
    run(manifest, store, tasks, newest_first=True)
    own = [source for source in tasks.done if "/v1/" in source]
    assert own == sorted(own, reverse=True)


@pytest.mark.slow
@pytest.mark.parametrize("after", [0, 1, 5, 11])
def test_an_interrupted_run_goes_on_and_ends_alike(tmp_path, manifest, after):
    whole, broken = (open_store(tmp_path / name, create=True) for name in ("whole", "broken"))
    run(manifest, whole, Tasks())
    first, second = Tasks(stop_after=after), Tasks()
    with pytest.raises(KeyboardInterrupt):
        run(manifest, broken, first)
    outcome, _ = run(manifest, broken, second)
    assert (len(first.done), outcome.skipped) == (after, after)
    assert not {*first.done} & {*second.done}
    assert table(broken) == table(whole)
    assert table(broken, "lidars") == table(whole, "lidars")
    outcome, _ = run(manifest, broken, tasks := Tasks())
    assert (outcome.skipped, tasks.done) == (12, [])


@pytest.mark.parametrize("reason", ["network", "not_found"])
def test_what_may_pass_is_taken_up_by_the_next_run(tmp_path, manifest, reason):
    store, offline = open_store(tmp_path / "store", create=True), "s3://logs/v2/1.mcap"
    outcome, _ = run(manifest, store, Tasks(failing=[offline], reason=reason))
    assert outcome.without_result == 1
    with ask(store, FAILURES) as answer:
        assert [row[2:7] for row in answer.rows()] == [(offline, "", "failed", reason, "lost")]
    outcome, _ = run(manifest, store, tasks := Tasks())
    assert tasks.done == [offline]
    assert outcome.without_result == 0
    with ask(store, FAILURES) as answer:
        assert list(answer.rows()) == []


@pytest.mark.parametrize(
    ("reason", "measured", "limit"), [("timeout", "elapsed_s", "time_s"), ("memory", "memory_mb", "memory_mb")]
)
def test_what_ended_at_a_limit_is_taken_up_at_a_larger_one(tmp_path, manifest, reason, measured, limit):
    store, done = open_store(tmp_path / "store", create=True), []

    def task(request, limits):
        done.append(request.source)
        row = replace(failed_row(request, reason, ""), **{measured: getattr(limits, limit)})
        open_store(request.store, create=False).finish(row, [])
        return row

    for size, logs in ((10.0, 12), (10.0, 0), (5.0, 0), (20.0, 12)):
        done.clear()
        run_fleet([manifest], store, FleetOptions(limits=LogTaskLimits(**{limit: size})), run_log_task=task)
        assert len(done) == logs, size


def test_other_tolerances_do_all_again(tmp_path, manifest):
    store = open_store(tmp_path / "store", create=True)
    run(manifest, store, Tasks())
    tolerances = RigTolerances(default=Tolerance(translation_m=0.001))
    assert run(manifest, store, Tasks(), tolerances=tolerances)[0].skipped == 0


def test_bytes_of_a_log_without_a_row_are_no_duplicate(tmp_path):
    """A task that was interrupted has noted the bytes, and the log is found under another path."""
    store = open_store(tmp_path, create=True)
    assert store.first_with("bytes", "v1", "c", "logs/a.mcap") == "logs/a.mcap"
    assert store.first_with("bytes", "v1", "c", "all/logs/a.mcap") == "all/logs/a.mcap"
    add_log(store, "v1", 0, lambda *_: [], source="all/logs/a.mcap")
    assert store.first_with("bytes", "v1", "c", "logs/a.mcap") == "all/logs/a.mcap"


@pytest.mark.slow
def test_two_drivers_on_one_store_do_no_harm(tmp_path, manifest):
    alone, shared = (open_store(tmp_path / name, create=True) for name in ("alone", "shared"))
    run(manifest, alone, Tasks())
    drivers = [threading.Thread(target=run, args=(manifest, shared, Tasks())) for _ in range(2)]
    for driver in drivers:
        driver.start()
    for driver in drivers:
        driver.join()
    assert table(shared) == table(alone)
    assert table(shared, "lidars") == table(alone, "lidars")


def test_new_logs_go_on_from_what_the_store_has(tmp_path, manifest):
    store = open_store(tmp_path / "store", create=True)
    run(manifest, store, Tasks())
    more = tmp_path / "more.csv"
    more.write_text("source,vehicle,time\ns3://logs/v1/new.mcap,v1,2026-12-01T00:00:00Z\n")
    outcome, _ = run(str(more), store, tasks := Tasks())
    assert (outcome.found, tasks.done) == (1, ["s3://logs/v1/new.mcap"])
    with ask(store, "SELECT state, reference FROM logs WHERE source LIKE '%new%'") as answer:
        ((state, reference),) = answer.rows()
    with ask(store, "SELECT calibration FROM logs WHERE source = 's3://logs/v1/2-moved.mcap'") as answer:
        assert list(answer.rows()) == [(reference,)]
    assert state == "verified"


def test_another_configuration_does_all_again_and_stands_once(tmp_path, manifest):
    store = open_store(tmp_path / "store", create=True)
    run(manifest, store, Tasks())
    outcome, _ = run(manifest, store, Tasks(), calibrate="always")
    assert outcome.skipped == 0
    assert len(table(store)) == 12
    assert len(list(store.parts("logs"))) == 24


@pytest.mark.slow
def test_joined_parts_hold_the_same_rows(tmp_path, manifest):
    store = open_store(tmp_path / "store", create=True)
    run(manifest, store, Tasks())
    before = table(store), table(store, "lidars")
    assert compact_store(store) == (24, 14)
    assert (table(store), table(store, "lidars")) == before
    outcome, _ = run(manifest, store, tasks := Tasks())
    assert (outcome.skipped, tasks.done) == (12, [])
    assert compact_store(store) == (14, 14)


@pytest.mark.slow
def test_a_compaction_that_was_killed_leaves_no_row_twice(tmp_path, manifest, monkeypatch):
    store = open_store(tmp_path / "store", create=True)
    run(manifest, store, Tasks())
    before = table(store), table(store, "lidars")
    monkeypatch.setattr(type(store), "remove", _killed)
    with pytest.raises(InterruptedError):
        compact_store(store)
    monkeypatch.undo()
    assert (table(store), table(store, "lidars")) == before
    compact_store(store)
    assert (table(store), table(store, "lidars")) == before
    assert len(list(store.parts("lidars"))) == 7


def _killed(*_):
    raise InterruptedError


def test_the_status_counts_per_vehicle(tmp_path, manifest):
    store = open_store(tmp_path / "store", create=True)
    run(manifest, store, Tasks())
    with ask(store, STATUS) as answer:
        rows = [dict(zip(answer.columns, row, strict=True)) for row in answer.rows()]
    assert [(row["vehicle"], row["logs"], row["verified"], row["calibrated"]) for row in rows] == [
        ("v1", 5, 3, 2),
        ("v2", 3, 1, 2),
        ("v3", 4, 2, 2),
    ]


def test_tasks_get_the_whole_path_of_a_store(manifest, tmp_path, monkeypatch):
    """A task may run in the folder of its log."""
    monkeypatch.chdir(tmp_path)
    given = []

    def run(request, _):
        given.append(request.store)
        return failed_row(request, "stub", "")

    run_fleet([manifest], open_store("store", create=True), FleetOptions(), run_log_task=run)
    assert {*given} == {str(tmp_path / "store")}


def test_a_folder_without_logs_is_told(tmp_path):
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "notes.txt").touch()
    store = open_store(tmp_path / "store", create=True)
    with pytest.raises(
        SourceNotFoundError, match=rf"^No log was found in {tmp_path}/logs; expected recordings, folders"
    ):
        run(str(tmp_path / "logs"), store, Tasks())
