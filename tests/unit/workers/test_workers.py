# SPDX-License-Identifier: Apache-2.0
import os
import shutil
import signal
import socket
from pathlib import Path

import numpy as np
import pytest

from multilica.errors import MissingDependencyError, UnfitSnapshotError, UnknownNameError, WorkerDiedError
from multilica.workers import available_cores, open_workers
from tests.unit.workers import tasks

CLOUD = np.asfortranarray(np.random.default_rng(1).normal(size=(1000, 3)))


@pytest.fixture(params=[1, 2, 3])
def workers(request):
    with open_workers(request.param) as pool:
        yield pool


@pytest.fixture
def two():
    with open_workers(2) as pool:
        yield pool


def memory_files():
    links = (link for link in Path("/proc/self/fd").iterdir() if link.is_symlink())
    return [link for link in links if "memfd:multilica" in str(link.readlink())]


def is_alive(process_id):
    try:
        return Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_results_come_in_the_order_of_the_items(workers):
    assert list(workers.map(tasks.nap, [0.1, 0.0, 0.05, 0.0])) == [0.1, 0.0, 0.05, 0.0]
    assert list(workers.map(tasks.square, range(500))) == [item * item for item in range(500)]
    assert list(workers.map(tasks.square, [])) == []


def test_first_results_do_not_wait_for_the_last(two):
    results = two.map(tasks.nap, [0.0, 3600.0])
    assert next(results) == 0.0


def test_shared_values_and_results_are_the_same_bits(workers):
    workers.share("cloud", CLOUD)
    for factor, result in zip((2.0, 3.0), workers.map(tasks.scaled, [2.0, 3.0]), strict=True):
        assert result.tobytes() == (factor * CLOUD).tobytes()


def test_arrays_keep_their_layout_and_are_read_only(two):
    two.share("cloud", CLOUD)
    assert list(two.map(tasks.layout, [np.zeros((0, 3)), CLOUD])) == [
        (True, False, False, (0, 3)),
        (True, False, False, (1000, 3)),
    ]
    (result,) = two.map(tasks.scaled, [2.0])
    assert not result.flags.writeable


def test_results_can_be_shared_by_name(workers):
    found = dict(workers.map_and_share(tasks.scaled_by, {"two": (CLOUD, 2.0), "three": (CLOUD, 3.0)}))
    assert [result.tobytes() for result in found.values()] == [(2.0 * CLOUD).tobytes(), (3.0 * CLOUD).tobytes()]
    totals = [float((2.0 * CLOUD).sum()), float((3.0 * CLOUD).sum())]
    assert list(workers.map(tasks.total_of, ["two", "three"] * 3)) == totals * 3
    with pytest.raises(ValueError, match="'two' is shared already"):
        list(workers.map_and_share(tasks.scaled_by, {"two": (CLOUD, 2.0)}))
    workers.forget(["two"])
    assert list(workers.map(tasks.total_of, ["three"])) == totals[1:]
    with pytest.raises(KeyError, match="two"):
        list(workers.map(tasks.total_of, ["two"]))


def test_a_task_that_fails_shares_nothing(workers):
    results = workers.map_and_share(tasks.fail, {"first": "fine", "second": "system", "third": "fine"})
    assert next(results) == ("first", "fine")
    with pytest.raises(OSError, match="No space"):
        next(results)
    with pytest.raises(KeyError, match="second"):
        list(workers.map(tasks.total_of, ["second"]))


def test_forgotten_values_can_be_shared_anew(workers):
    workers.share("cloud", CLOUD)
    assert next(iter(workers.map(tasks.total, [1]))) == float(CLOUD.sum())
    with pytest.raises(ValueError, match="'cloud' is shared already"):
        workers.share("cloud", CLOUD)
    workers.forget()
    workers.share("cloud", 2.0 * CLOUD)
    assert next(iter(workers.map(tasks.total, [2]))) == float((2.0 * CLOUD).sum())
    workers.forget()
    with pytest.raises(KeyError, match="cloud"):
        list(workers.map(tasks.scaled, [1.0]))


@pytest.mark.parametrize(
    ("kind", "error", "text"),
    [
        ("missing", MissingDependencyError, "It is not installed."),
        ("unknown", UnknownNameError, "There is no preset 'papper' in here; available: paper. Did you mean 'paper'?"),
        ("unfit", UnfitSnapshotError, "It moves."),
        ("system", OSError, "[Errno 28] No space left on device: 'file'"),
        ("local", Exception, "from here"),
    ],
)
def test_exceptions_of_tasks_arrive_as_themselves(kind, error, text, workers):
    results = workers.map(tasks.fail, ["fine", kind, "system"])
    assert next(results) == "fine"
    with pytest.raises(error) as caught:
        next(results)
    assert text in str(caught.value)
    assert list(workers.map(tasks.square, [3])) == [9]
    if kind == "unfit":
        assert caught.value.code == "moving_vehicle"


def test_the_trace_of_a_task_is_the_cause(two):
    with pytest.raises(MissingDependencyError) as caught:
        list(two.map(tasks.fail, ["missing"]))
    assert "in fail\n" in str(caught.value.__cause__)


def test_values_that_cannot_travel_are_errors(two):
    with pytest.raises(AttributeError, match="local object"):
        list(two.map(tasks.fail, ["unpicklable"]))
    with pytest.raises(ImportError, match="libGL"):
        list(two.map(tasks.square, [tasks.Unreadable()]))
    assert list(two.map(tasks.square, [3])) == [9]


def test_an_abandoned_map_does_not_disturb_the_next(workers):
    results = workers.map(tasks.nap, [0.0, 0.05, 0.05, 0.05, 0.05])
    assert next(results) == 0.0
    results.close()
    assert list(workers.map(tasks.square, range(4))) == [0, 1, 4, 9]


def test_a_map_within_a_map(workers):
    rows = [list(workers.map(tasks.square, range(size))) for size in workers.map(tasks.square, range(4))]
    assert [len(row) for row in rows] == [0, 1, 4, 9]


def test_one_worker_is_this_process(monkeypatch):
    monkeypatch.setattr("subprocess.Popen", None)
    with open_workers(1) as workers:
        assert [found[0] for found in workers.map(tasks.processes, range(3))] == [os.getpid()] * 3


def test_no_number_means_the_available_cores(monkeypatch):
    assert available_cores() == len(os.sched_getaffinity(0))
    monkeypatch.setattr("multilica.workers.processes.available_cores", lambda: 1)
    with open_workers(0) as workers:
        assert next(workers.map(tasks.processes, range(3)))[0] == os.getpid()
    monkeypatch.setattr("multilica.workers.processes.available_cores", lambda: 2)
    with open_workers(0) as workers:
        assert next(workers.map(tasks.processes, range(3)))[0] != os.getpid()


def test_workers_are_as_many_as_there_is_work_for(two):
    assert len({worker for worker, _, _ in two.map(tasks.processes, range(1))}) == 1
    found = list(two.map(tasks.processes, range(10)))
    assert len({worker for worker, _, _ in found}) == 2
    assert os.getpid() not in found[0]


def test_each_worker_has_one_thread(two):
    assert list(two.map(tasks.threads, range(2))) == [1, 1]


def test_nothing_is_left_behind():
    with open_workers(2, ["multilica.geometry", "no_such_module"]) as workers:
        workers.share("cloud", CLOUD)
        found = list(workers.map(tasks.processes, range(10)))
        results = workers.map(tasks.nap, [0.0, 3600.0, 3600.0])
        next(results)
        assert memory_files()
    assert not any(is_alive(process) for worker, server, _ in found for process in (worker, server))
    results.close()
    assert memory_files() == []


def test_a_pool_that_is_not_used_ends_at_once():
    with open_workers(2, ["multilica.pipeline"]):
        pass


def test_a_worker_that_is_killed_ends_the_map(two):
    with pytest.raises(WorkerDiedError, match="memory"):
        list(two.map(tasks.die, range(50)))
    with pytest.raises(WorkerDiedError):
        list(two.map(tasks.nap, [0.0, 3600.0]))


def test_workers_that_do_not_start_end_the_map(monkeypatch):
    monkeypatch.setattr("sys.executable", shutil.which("false"))
    with open_workers(2) as workers, pytest.raises(WorkerDiedError):
        list(workers.map(tasks.square, range(3)))


@pytest.fixture
def given_up():
    """End a wait that would last for ever."""

    def give_up(*_):
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(30)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.usefixtures("given_up")
@pytest.mark.parametrize("closed", [0, 1, 2])
def test_a_signal_while_it_closes_leaves_nothing_behind(monkeypatch, closed):
    close, left = socket.socket.close, iter(range(closed))
    found = []

    def close_some(each):
        if next(left, None) is None:
            monkeypatch.setattr(socket.socket, "close", close)
            raise KeyboardInterrupt
        close(each)

    def run():
        with open_workers(2) as workers:
            workers.share("cloud", CLOUD)
            found.extend(workers.map(tasks.processes, range(10)))
            monkeypatch.setattr(socket.socket, "close", close_some)

    with pytest.raises(KeyboardInterrupt):
        run()
    assert found
    assert not any(is_alive(process) for worker, server, _ in found for process in (worker, server))
    assert memory_files() == []
