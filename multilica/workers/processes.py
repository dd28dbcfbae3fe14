# SPDX-License-Identifier: Apache-2.0
"""Tasks whose results come in the order of the items, run by this process or spread over others."""

import gc
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from importlib import import_module
from itertools import count
from selectors import EVENT_READ, DefaultSelector
from typing import Any, NoReturn, TypeVar

from multilica.allocator import keep_freed_memory
from multilica.errors import WorkerDiedError
from multilica.workers.messages import (
    UNREADABLE,
    Answer,
    Job,
    Release,
    Shared,
    TaskTracebackError,
    WorkerFailure,
    claim_next,
    pack,
    unpack,
)

# Read by OpenMP, OpenBLAS and MKL when they are loaded. OpenBLAS and MKL fall back to the first.
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class Workers:
    """Runs tasks in this process; `WorkerProcesses` runs them in others.

    Attributes:
        processes: the most other processes that run tasks at the same time.
    """

    def __init__(self) -> None:
        self.processes = 0
        self._shared = Shared()

    def share(self, name: str, value: object) -> None:
        """Make a value available to all tasks as ``shared[name]``; its arrays are copied once, for all workers.

        Raises:
            ValueError: the name is taken; `forget` frees it.
        """
        self._shared.add(name, value)

    def forget(self, names: Collection[str] | None = None) -> None:
        """Drop shared values, all if no names are given."""
        self._shared.drop(names)

    def map(self, function: Callable[[Shared, _Item], _Result], items: Sequence[_Item]) -> Iterator[_Result]:
        """Yield ``function(shared, item)`` for each item in order, each as soon as it and those before are there.

        The tasks start with the first ``next``; worker processes go on while the caller uses a result. For them, items
        and results are copies with read-only arrays. The results do not depend on the number of workers if a task
        depends on its item and the shared values alone.

        Args:
            function: a function of a module other than the main module.

        Raises:
            WorkerDiedError: a worker was killed or crashed.
            Exception: whatever a task raises, after the results of the items before it.
        """
        for item in items:
            yield function(self._shared, item)

    def map_and_share(
        self, function: Callable[[Shared, _Item], _Result], items: Mapping[str, _Item]
    ) -> Iterator[tuple[str, _Result]]:
        """Yield the name and the result of each item as `map` does, and share the result under that name.

        Raises:
            ValueError: a name is taken.
        """
        for name, item in items.items():
            self._shared.add(name, result := function(self._shared, item))
            yield name, result


def available_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


@contextmanager
def open_workers(workers: int, modules: Sequence[str] = ()) -> Iterator[Workers]:
    """Open a pool of worker processes with one thread each; none is left when the context ends.

    Opening does not wait for the processes: they import the modules while the caller goes on. They do not import the
    main module of the caller.

    Args:
        workers: the most processes that work at the same time; 0: one per available core. With one, no process is
            started, and the tasks run in this one.
        modules: imported once for all workers: those of the tasks and the libraries that they use.
    """
    most = workers or available_cores()
    if most <= 1:
        yield Workers()
        return
    control, theirs = socket.socketpair()
    with control:
        with theirs:
            server = _start_server(theirs, modules)
        with server:
            pool = WorkerProcesses(most, control)
            try:
                yield pool
            finally:
                try:
                    _stop(pool, control, server)
                finally:  # a signal may have interrupted it; the server waits for the end of the socket
                    _stop(pool, control, server)


def _stop(pool: "WorkerProcesses", control: socket.socket, server: subprocess.Popen[bytes]) -> None:
    pool.close()
    control.close()
    server.terminate()


class WorkerProcesses(Workers):
    """Runs tasks in worker processes, which are forked when there are tasks for them.

    Args:
        processes: the most at the same time.
        control: the socket of the server that forks them.
    """

    def __init__(self, processes: int, control: socket.socket) -> None:
        super().__init__()
        self.processes = processes
        self._control = control
        self._buffers: dict[str, int] = {}
        self._jobs: dict[int, tuple[int, dict[int, Any]]] = {}
        self._numbers = count()
        self._selector = DefaultSelector()
        self._workers: list[socket.socket] = []
        self._ready: list[socket.socket] = []

    def share(self, name: str, value: object) -> None:  # noqa: D102
        super().share(name, value)
        self._keep(name, pack(Answer(UNREADABLE, 0, value, name)))

    def forget(self, names: Collection[str] | None = None) -> None:  # noqa: D102
        super().forget(names)
        for name in tuple(self._buffers) if names is None else names:
            os.close(self._buffers.pop(name))
        buffer = pack(Release(names))
        self._tell(buffer)
        os.close(buffer)

    def map(  # noqa: D102
        self, function: Callable[[Shared, _Item], _Result], items: Sequence[_Item]
    ) -> Iterator[_Result]:
        return self._map(function, items, ())

    def map_and_share(  # noqa: D102
        self, function: Callable[[Shared, _Item], _Result], items: Mapping[str, _Item]
    ) -> Iterator[tuple[str, _Result]]:
        self._shared.require_free(items)
        return zip(items, self._map(function, tuple(items.values()), tuple(items)), strict=True)

    def _map(
        self, function: Callable[[Shared, _Item], _Result], items: Sequence[_Item], names: Sequence[str]
    ) -> Iterator[_Result]:
        number, answers = next(self._numbers), dict[int, Any]()
        buffer = pack(Job(number, function, items, names))
        self._jobs[number] = buffer, answers
        try:
            self._tell(buffer)
            self._fork(min(self.processes, len(items)))
            for index in range(len(items)):
                while index not in answers:
                    self._receive()
                yield _result_of(answers.pop(index))
        finally:
            del self._jobs[number]
            claim_next(buffer, ends=True)
            os.close(buffer)

    def close(self) -> None:
        """Close the connections to the workers, if that is not done yet."""
        self._selector.close()
        for worker in self._workers:
            worker.close()
        while self._buffers:
            os.close(self._buffers.popitem()[1])

    def _fork(self, workers: int) -> None:
        """Have workers forked until there are as many."""
        while len(self._workers) < workers:
            ours, theirs = socket.socketpair()
            self._workers.append(ours)
            self._selector.register(ours, EVENT_READ, ours)
            with theirs:
                _send(self._control, theirs.fileno())

    def _keep(self, name: str, buffer: int) -> None:
        """Tell the workers a value to share, those of now and those to come."""
        self._buffers[name] = buffer
        self._tell(buffer)

    def _tell(self, buffer: int) -> None:
        for worker in self._ready:
            _send(worker, buffer)

    def _receive(self) -> None:
        """Wait for messages of the workers, and keep the answers to jobs that are still open."""
        for key, _ in self._selector.select():
            sent, buffers = b"", list[int]()
            with suppress(ConnectionResetError):
                sent, buffers, _, _ = socket.recv_fds(key.data, 1, 1)
            if not sent:
                _raise_died()
            if not buffers:
                self._ready.append(key.data)  # it has just started, and learns what the others know
                for buffer in (*self._buffers.values(), *(buffer for buffer, _ in self._jobs.values())):
                    _send(key.data, buffer)
                continue
            answer: Any = unpack(buffers[0])
            wanted = answer.job in self._jobs
            if wanted and answer.name is not None:
                super().share(answer.name, answer.value)
                self._keep(answer.name, buffers[0])
            else:
                os.close(buffers[0])
            if answer.job == UNREADABLE:
                _result_of(answer.value)
            if wanted:
                self._jobs[answer.job][1][answer.item] = answer.value


def _result_of(answer: Any) -> Any:  # noqa: ANN401 - results have any type
    if isinstance(answer, WorkerFailure):
        raise answer.error from TaskTracebackError(answer.trace)
    return answer


def _send(receiver: socket.socket, buffer: int) -> None:
    try:
        socket.send_fds(receiver, [b"."], [buffer])
    except (BrokenPipeError, ConnectionResetError):
        _raise_died()


def _raise_died() -> NoReturn:
    raise WorkerDiedError(
        "A worker process died, perhaps because memory ran out; use fewer --workers, fewer --frames or a larger "
        "preprocess.voxel_size_m."
    ) from None


def _start_server(control: socket.socket, modules: Sequence[str]) -> subprocess.Popen[bytes]:
    """Start the process, without waiting for it.

    Args:
        control: each socket that is sent through it is served by a new worker; when its other end is closed, the
            server ends with all its workers.
        modules: imported once, before the first worker is forked.
    """
    # The main module of the caller is not imported: it may be a script that runs on import.
    command = (
        f"import sys; sys.path[:] = {sys.path!r}; "
        f"from multilica.workers.processes import serve; serve({control.fileno()}, {list(modules)!r})"
    )
    return subprocess.Popen(  # noqa: S603
        [sys.executable, "-c", command],
        stdin=subprocess.DEVNULL,
        pass_fds=[control.fileno()],
        start_new_session=True,  # signals of the terminal are the caller's
        env={**os.environ, **_ONE_THREAD},
    )


def serve(control_descriptor: int, modules: Sequence[str]) -> None:
    """Import modules, fork a worker for each socket that arrives, and end with them when the caller is gone.

    Until the modules are imported, SIGTERM ends this process; from then on, only the end of the control socket does.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    keep_freed_memory()
    for module in modules:
        with suppress(Exception):  # raised again, to the caller, by the task that needs it
            import_module(module)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    gc.freeze()  # keeps the collector of a worker from writing to memory that it shares with the others
    children: list[int] = []
    with socket.socket(fileno=control_descriptor) as control:
        while True:
            _, descriptors, _, _ = socket.recv_fds(control, 1, 1)
            if not descriptors:
                break
            # Without memory for a fork, the caller sees the end of its socket.
            with socket.socket(fileno=descriptors[0]) as caller, suppress(OSError):
                child = os.fork()
                if child == 0:
                    try:
                        control.close()
                        _work(caller)
                    finally:
                        os._exit(0)
                children.append(child)
    for child in children:
        os.kill(child, signal.SIGKILL)
    for child in children:
        os.waitpid(child, 0)
    os._exit(0)  # without the tidying up of libraries


def _work(caller: socket.socket) -> None:
    """Work until the caller closes its end."""
    # Few results wait in the socket, so a caller that is slow to read them holds the worker back.
    caller.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1)
    shared = Shared()
    caller.send(b".")
    while True:
        _, descriptors, _, _ = socket.recv_fds(caller, 1, 1)
        if not descriptors:
            return
        (descriptor,) = descriptors
        try:
            message = unpack(descriptor)
        except Exception as error:  # noqa: BLE001
            _answer(caller, pack(Answer(UNREADABLE, 0, WorkerFailure.of(error))))
        else:
            match message:
                case Release(names):
                    shared.drop(names)
                case Answer(_, _, value, str(name)):
                    shared.add(name, value)
                case Job(number, function, items, names):
                    while (index := claim_next(descriptor)) < len(items):
                        task = partial(function, shared, items[index])
                        _run(caller, number, index, task, names[index] if names else None)
        os.close(descriptor)


def _run(caller: socket.socket, job: int, index: int, task: Callable[[], object], name: str | None) -> None:
    try:
        buffer = pack(Answer(job, index, task(), name))
    except Exception as error:  # noqa: BLE001
        buffer = pack(Answer(job, index, WorkerFailure.of(error)))
    _answer(caller, buffer)


def _answer(caller: socket.socket, buffer: int) -> None:
    _send(caller, buffer)
    os.close(buffer)
