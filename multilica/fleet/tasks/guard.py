# SPDX-License-Identifier: Apache-2.0
"""Log tasks and their executors, each task in a process of its own, with limits of time and memory.

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
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from multiprocessing import Pipe
from typing import Any, Literal

import multilica
from multilica.checks import RigTolerances
from multilica.config import CalibrationConfig
from multilica.errors import SourceNotFoundError, StorageError, UsageError
from multilica.fleet.listing import FleetLog
from multilica.fleet.store.records import LogRow
from multilica.fleet.store.store import open_store
from multilica.ingest.metadata import LogIdentity
from multilica.optional_libraries import needed_for

Calibrate = Literal["when-needed", "always"]

_PAUSES_S = (0.5, 2.0, 8.0)
_KILLED = {signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT}
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS"), "1")
_SERVER = "multilica.fleet.tasks.run_task"
_IDENTIFY_S = 60.0
_OF_ROW = ("key", "vehicle", "time_ns", "source", "fingerprint", "size_bytes", "config_sha256", "reference")
"""Fields of a task that are also fields of its row."""
_LOCAL = threading.local()
_RUNNING: set[_TaskProcess] = set()
_STOPPED = threading.Event()


@dataclass(frozen=True, slots=True, kw_only=True)
class LogTask(FleetLog):
    """The input of a worker for one log.

    Args:
        reference: path in the store of the vehicle's last accepted poses; empty if there are none.
        ahead: logs of the vehicle before this one are not decided; so neither is its row to be written.
        max_memory_mb: limit of the process, for the row of a log that needs more.
    """

    key: str
    store: str
    config: CalibrationConfig
    config_sha256: str
    tolerances: RigTolerances
    calibrate: Calibrate
    reference: str
    ahead: bool = False
    attempt: int = 1
    max_memory_mb: float = 0.0

    def row(self) -> LogRow:
        """Return the part of the row that is known beforehand."""
        known = {name: getattr(self, name) for name in _OF_ROW}
        version = multilica.__version__
        return LogRow(**known, state="failed", version=version, calibration=self.reference, attempts=self.attempt)


@dataclass(frozen=True, slots=True)
class LogTaskFailure:
    """Reason why a task ended without a row; `passes` if it may be gone at the next try."""

    reason: str
    text: str
    passes: bool = False


def failed_row(request: LogTask, reason: str, text: str, *, state: Literal["refused", "failed"] = "failed") -> LogRow:
    """Return the row of a log without a result; the poses that held before it still hold."""
    told = text.replace(request.address, request.source)
    return replace(request.row(), state=state, reason=reason, reason_text=told, finished_at=datetime.now(UTC))


LARGEST_LIMIT = 1e6
"""The largest limit in seconds or megabytes: eleven days, a terabyte."""


@dataclass(frozen=True, slots=True)
class LogTaskLimits:
    """Limits of a task: until it is killed, on top of what the libraries take, and tries after what may pass.

    Raises:
        UsageError: a limit is above `LARGEST_LIMIT`, or no number.
    """

    time_s: float = 600.0
    memory_mb: float = 4000.0
    retries: int = 5

    def __post_init__(self) -> None:
        for name, value in (("time limit", self.time_s), ("memory limit", self.memory_mb)):
            if not value <= LARGEST_LIMIT:
                raise UsageError(f"The {name} of a log is {value:g}; expected at most {LARGEST_LIMIT:g}.")


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


def _dask_client(scheduler: str) -> Any:  # noqa: ANN401 - a type of Dask
    with needed_for(f"The Dask scheduler {scheduler}", "distributed"):
        from distributed import Client
        from distributed.security import Security
    security = Security(require_encryption=True) if scheduler.startswith(("tls", "wss")) else None
    try:
        return _connected(lambda: Client(scheduler, timeout=30, security=security, set_as_default=False))
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise SourceNotFoundError(
            f"No Dask scheduler answers at {scheduler} ({type(error).__name__}); check the address, and the "
            "certificates in the configuration of Dask."
        ) from error


def _connected(connect: Callable[[], Any]) -> Any:  # noqa: ANN401 - a type of Dask
    """Connect, once more if Dask's own thread did not start within the 10 s that it waits, on a busy machine."""
    try:
        return connect()
    except AssertionError:
        return connect()


def run_guarded(request: LogTask, limits: LogTaskLimits) -> LogRow:
    """Run a task, again after what may pass; write the row of one that ended without.

    Raises:
        StorageError: as `_tried`.
    """
    answer: LogRow | LogTaskFailure
    request = replace(request, max_memory_mb=limits.memory_mb)
    answer, attempt = _tried(lambda attempt: replace(request, attempt=attempt), limits.time_s, limits)
    if isinstance(answer, LogTaskFailure):
        answer = failed_row(replace(request, attempt=attempt), answer.reason, answer.text)
        if answer.reason == "timeout":
            answer = replace(answer, elapsed_s=limits.time_s)
        elif answer.reason == "memory":
            answer = replace(answer, memory_mb=limits.memory_mb)
        if not request.ahead:
            open_store(request.store, create=False).finish(answer, [])
    return answer


def identify_guarded(address: str, limits: LogTaskLimits) -> LogIdentity:
    """Read vehicle and time of a log, again after what may pass; nothing if that takes too much.

    Raises:
        StorageError: as `_tried`.
    """
    answer: LogIdentity | LogTaskFailure
    answer, _ = _tried(lambda _: address, min(_IDENTIFY_S, limits.time_s), limits)
    return LogIdentity("", None) if isinstance(answer, LogTaskFailure) else answer


def _tried(request: Callable[[int], LogTask | str], time_s: float, limits: LogTaskLimits) -> tuple[Any, int]:
    """Make the request of each attempt up to an answer, or a failure that does not pass; with the number of tries.

    Raises:
        StorageError: a disk or the store is full or refuses, which says nothing about the log.
    """
    for attempt in range(1, limits.retries + 2):
        if attempt > 1:
            _STOPPED.wait(_PAUSES_S[min(attempt - 1, len(_PAUSES_S)) - 1])
        answer = _process(limits).ask(request(attempt), time_s)
        if _STOPPED.is_set():
            raise CancelledError
        if not (isinstance(answer, LogTaskFailure) and answer.passes):
            break
    if isinstance(answer, LogTaskFailure) and answer.reason == "storage":
        raise StorageError(answer.text)
    return answer, attempt


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
            text = f"The process of the log was killed ({signal.Signals(-code).name})."
            return LogTaskFailure("killed", text, passes=True)
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
