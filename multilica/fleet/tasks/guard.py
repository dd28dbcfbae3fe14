# SPDX-License-Identifier: Apache-2.0
"""Executors of log tasks, each task in a process of its own, with limits of time and memory.

Every executor runs `run_guarded`, in a thread of this process or of a Dask worker. Each such thread keeps one child
process, so that libraries are loaded once, and one that crashes, hangs or takes too much memory ends only that.
"""

from __future__ import annotations

import atexit
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import Pipe
from typing import Any

from pydantic import BaseModel, ConfigDict

from multilica.errors import SourceNotFoundError, UsageError
from multilica.fleet.store.records import PASSING, LogRow
from multilica.fleet.store.store import open_store
from multilica.fleet.tasks.log_task import LogTask, LogTaskFailure, failed_row
from multilica.ingest.metadata import LogIdentity
from multilica.optional_libraries import needed_for

_PAUSES_S = (0.5, 2.0, 8.0)
_KILLED = {signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT}
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS"), "1")
_SERVER = "multilica.fleet.tasks.task_server"
_IDENTIFY_S = 60.0
_LOCAL = threading.local()
_RUNNING: set[_TaskProcess] = set()
_STOPPED = threading.Event()


class LogTaskLimits(BaseModel):
    """Limits of a task: until it is killed, on top of what the libraries take, and tries after what may pass."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    time_s: float = 600.0
    memory_mb: float = 4000.0
    retries: int = 5


@contextmanager
def open_executor(workers: int, scheduler: str = "") -> Iterator[tuple[Executor, int]]:
    """Open the executor of a run; yield it with the number of tasks that it runs at once.

    Args:
        workers: tasks at once on this machine.
        scheduler: address of a Dask scheduler; empty for this machine. Certificates for ``tls://`` come from Dask's own
            configuration.

    Raises:
        UsageError: not an address of a scheduler.
        MissingDependencyError: `distributed` is not installed.
        SourceNotFoundError: no scheduler answers there, or it has no workers.
    """
    if not scheduler:
        _STOPPED.clear()
        with ThreadPoolExecutor(workers, thread_name_prefix="log-task") as pool:
            try:
                yield pool, workers
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
            finally:
                end_processes()
        return
    if not scheduler.startswith(("tcp://", "tls://", "ws://", "wss://")):
        raise UsageError(f"Found --scheduler {scheduler}; expected tcp://HOST:PORT or tls://HOST:PORT.")
    with _dask_client(scheduler) as client:
        threads = sum(client.nthreads().values())
        if threads == 0:
            raise SourceNotFoundError(f"The Dask scheduler at {scheduler} has no workers; start `dask worker` first.")
        executor = client.get_executor(pure=False, retries=2)
        try:
            yield executor, threads
        finally:
            executor.shutdown(wait=False)


@contextmanager
def _dask_client(scheduler: str) -> Iterator[Any]:
    with needed_for(f"The Dask scheduler {scheduler}", "distributed"):
        from distributed import Client
        from distributed.security import Security
    security = Security(require_encryption=True) if scheduler.startswith(("tls", "wss")) else None
    try:
        client = _connected(lambda: Client(scheduler, timeout=30, security=security, set_as_default=False))
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise SourceNotFoundError(
            f"No Dask scheduler answers at {scheduler} ({type(error).__name__}); check the address, and the "
            "certificates in the configuration of Dask."
        ) from error
    with client:
        yield client


def _connected(connect: Callable[[], Any]) -> Any:  # noqa: ANN401 - a type of Dask
    """Connect, once more if Dask's own thread did not start within the 10 s that it waits, on a busy machine."""
    try:
        return connect()
    except AssertionError:
        return connect()


def run_guarded(request: LogTask, limits: LogTaskLimits) -> LogRow:
    """Run a task, again after what may pass; write the row of one that ended without."""
    tried = request

    def ask(attempt: int) -> Any:  # noqa: ANN401 - what the server answers
        nonlocal tried
        tried = request.model_copy(update={"attempt": attempt})
        return _process(limits).ask(tried, limits.time_s)

    answer: LogRow | LogTaskFailure = _tried(ask, limits)
    if isinstance(answer, LogTaskFailure):
        answer = failed_row(tried, answer.reason, answer.text)
        open_store(request.store, create=False).finish(answer, [])
    return answer


def identify_guarded(address: str, limits: LogTaskLimits) -> LogIdentity:
    """Read vehicle and time of a log, again after what may pass; nothing if that takes too much."""
    time_s = min(_IDENTIFY_S, limits.time_s)
    answer: LogIdentity | LogTaskFailure = _tried(lambda _: _process(limits).ask(address, time_s), limits)
    return LogIdentity("", None) if isinstance(answer, LogTaskFailure) else answer


def _tried(ask: Callable[[int], Any], limits: LogTaskLimits) -> Any:  # noqa: ANN401 - as above
    """Ask up to an answer, or a failure that does not pass."""
    for attempt in range(limits.retries + 1):
        if attempt:
            _STOPPED.wait(_PAUSES_S[min(attempt, len(_PAUSES_S)) - 1])
        answer = ask(attempt + 1)
        if _STOPPED.is_set():
            raise CancelledError
        if not (isinstance(answer, LogTaskFailure) and answer.reason in PASSING):
            break
    return answer


def end_processes() -> None:
    """End the child processes of all threads, and start no more; what they were doing is not finished."""
    _STOPPED.set()
    for process in [*_RUNNING]:
        process.end()


def _process(limits: LogTaskLimits) -> _TaskProcess:
    kept: _TaskProcess | None = getattr(_LOCAL, "process", None)
    if kept is None or kept.memory_mb != limits.memory_mb or not kept.is_alive:
        if kept is not None:
            kept.end()
        if _STOPPED.is_set():
            raise CancelledError
        _LOCAL.process = kept = _TaskProcess(limits.memory_mb)
    return kept


class _TaskProcess:
    def __init__(self, memory_mb: float) -> None:
        self.memory_mb = memory_mb
        self._connection, server = Pipe()
        with server:
            self._process = subprocess.Popen(  # noqa: S603 - a module of this package
                [sys.executable, "-m", _SERVER, str(server.fileno()), str(memory_mb)],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env=os.environ | _ONE_THREAD,
                start_new_session=True,
                pass_fds=[server.fileno()],
            )
        _RUNNING.add(self)

    @property
    def is_alive(self) -> bool:
        return self._process.poll() is None

    def ask(self, request: LogTask | str, time_s: float) -> Any:  # noqa: ANN401 - what the server answers
        """Return the answer, or the LogTaskFailure that says why there is none."""
        try:
            self._connection.send(request)
            if self._connection.poll(time_s):
                return self._connection.recv()
        except (OSError, EOFError):
            return self._death()
        self.end()
        return LogTaskFailure("timeout", f"The log took more than {time_s:g} s.")

    def _death(self) -> LogTaskFailure:
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(5.0)
        self.end()
        code = self._process.returncode
        if -code in _KILLED:
            return LogTaskFailure("killed", f"The process of the log was killed ({signal.Signals(-code).name}).")
        how = f"signal {signal.Signals(-code).name}" if code < 0 else f"code {code}"
        return LogTaskFailure("crashed", f"The process of the log ended with {how}; a library crashed on it.")

    def end(self) -> None:
        """Kill the process and what it started."""
        if self.is_alive:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        assert self._process.stdin  # noqa: S101
        self._process.stdin.close()  # the connection stays open: another thread may wait at it
        _RUNNING.discard(self)


atexit.register(end_processes)
