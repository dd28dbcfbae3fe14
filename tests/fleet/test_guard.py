# SPDX-License-Identifier: Apache-2.0
import threading
from concurrent.futures import CancelledError
from dataclasses import replace

import pytest

from multilica.errors import UsageError
from multilica.fleet.store.store import open_store
from multilica.fleet.tasks import guard
from multilica.fleet.tasks.guard import LogTaskLimits, identify_guarded, run_guarded
from tests.fleet.support.requests import request

pytestmark = pytest.mark.slow

LIMITS = LogTaskLimits(time_s=60.0, memory_mb=500.0, retries=2)


@pytest.fixture(autouse=True)
def _failing_units(monkeypatch):
    monkeypatch.setattr(guard, "_SERVER", "tests.fleet.support.failing_tasks")
    monkeypatch.setattr(guard, "_PAUSES_S", (0.0,))
    guard._STOPPED.clear()
    yield
    guard.end_processes()


def rows(folder):
    return open_store(folder / "store", create=False).dataset("logs").to_table().to_pylist()


@pytest.mark.in_turn
@pytest.mark.parametrize(
    ("source", "reason", "words"),
    [
        ("crash-1", "crashed", "SIGABRT"),
        ("memory-1", "memory", "more memory"),
        ("bug-1", "bug", "ZeroDivisionError: nothing to divide by"),
        ("unreachable-1", "network", "connection was lost"),
    ],
)
def test_a_unit_that_ends_badly_has_its_row(tmp_path, source, reason, words):
    summary = run_guarded(request(tmp_path, source, reference="runs/a/reference.toml"), LIMITS)
    assert (summary.state, summary.reason) == ("failed", reason)
    (row,) = rows(tmp_path)
    assert (row["state"], row["reason"], row["source"]) == ("failed", reason, source)
    assert words in row["reason_text"]
    assert row["calibration"] == "runs/a/reference.toml"
    assert row["attempts"] == (3 if reason == "network" else 1)
    assert (row["memory_mb"] == LIMITS.memory_mb) is (reason == "memory")


@pytest.mark.in_turn
def test_a_unit_that_hangs_is_killed(tmp_path):
    run_guarded(request(tmp_path, "fine-1"), LIMITS)  # the libraries are loaded
    summary = run_guarded(request(tmp_path, "hang-1"), replace(LIMITS, time_s=0.5))
    assert (summary.state, summary.reason, summary.elapsed_s) == ("failed", "timeout", 0.5)


@pytest.mark.parametrize("source", ["killed-1", "offline-1"])
@pytest.mark.in_turn
def test_what_may_pass_is_tried_again(tmp_path, source):
    assert run_guarded(request(tmp_path, source), LIMITS).reason == "stub"
    (row,) = rows(tmp_path)
    assert row["attempts"] == 2


def test_units_of_a_thread_share_a_process_until_one_crashes(tmp_path):
    told = [run_guarded(request(tmp_path, name), LIMITS) for name in ("fine-1", "fine-2", "crash-1", "fine-3")]
    first, second, crashed, after = (each.reason_text for each in told)
    assert first == second != after
    assert "SIGABRT" in crashed


def test_after_the_end_no_unit_runs_and_no_row_is_written(tmp_path):
    threading.Timer(1.5, guard.end_processes).start()
    with pytest.raises(CancelledError):
        run_guarded(request(tmp_path, "hang-1"), LIMITS)
    with pytest.raises(CancelledError):
        run_guarded(request(tmp_path, "fine-1"), LIMITS)
    assert rows(tmp_path) == []


def test_each_thread_has_a_process(tmp_path):
    told = []

    def run(name):
        told.append(run_guarded(request(tmp_path, name), LIMITS).reason_text)

    threads = [threading.Thread(target=run, args=(f"fine-{number}",)) for number in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({*told}) == 2


@pytest.mark.parametrize("source", ["killed-1", "offline-1"])
@pytest.mark.in_turn
def test_a_log_is_identified_again_after_what_may_pass(tmp_path, source):
    assert identify_guarded(str(tmp_path / source), LIMITS) == guard.LogIdentity("v7", 7)


def test_a_log_that_is_nothing_has_no_identity(tmp_path, monkeypatch):
    monkeypatch.undo()
    guard._STOPPED.clear()
    assert identify_guarded(str(tmp_path / "none.mcap"), LIMITS) == guard.LogIdentity("", None)


@pytest.mark.parametrize("limits", [{"time_s": float("inf")}, {"memory_mb": 1e14}, {"memory_mb": float("nan")}])
def test_limits_without_a_bound_are_refused(limits):
    with pytest.raises(UsageError, match="expected at most 1e"):
        LogTaskLimits(**limits)
