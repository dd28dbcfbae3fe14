# SPDX-License-Identifier: Apache-2.0
"""Units in a process of their own, with limits of time and memory.

Every executor runs `run_guarded`, in a thread of this process or of a Dask worker. Each such thread keeps one child
process, so that libraries are loaded once, and one that crashes, hangs or takes too much memory ends only that.
"""

from __future__ import annotations

import atexit
import json
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import CancelledError
from contextlib import suppress
from typing import Any

from pydantic import BaseModel, ConfigDict

from multilica.fleet.store.records import PASSING
from multilica.fleet.store.store import open_store
from multilica.fleet.tasks.log_task import LogTask, LogTaskSummary, failed_row
from multilica.ingest.metadata import LogIdentity

_PAUSES_S = (0.5, 2.0, 8.0)
_KILLED = {signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT}
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS"), "1")
_READ_BYTES = 1 << 16
_SERVER = "multilica.fleet.tasks.task_server"
_IDENTIFY_S = 60.0
_LOCAL = threading.local()
_RUNNING: set[_TaskProcess] = set()
_STOPPED = threading.Event()


class LogTaskLimits(BaseModel):
    """What a task may take.

    Attributes:
        time_s: from its start to its end, then it is killed.
        memory_mb: on top of what the libraries take.
        retries: after a lost connection or a kill from outside.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    time_s: float = 600.0
    memory_mb: float = 4000.0
    retries: int = 5


def run_guarded(request: LogTask, limits: LogTaskLimits) -> LogTaskSummary:
    """Run a task, again after what may pass; write the row of one that ended without."""
    tried = request

    def ask(attempt: int) -> dict[str, Any]:
        nonlocal tried
        tried = request.model_copy(update={"attempt": attempt})
        return _process(limits).ask({"task": tried.model_dump(mode="json")}, limits.time_s)

    answer = _tried(ask, limits)
    if "summary" in answer:
        return LogTaskSummary.model_validate(answer["summary"])
    row = failed_row(tried, answer["reason"], answer["text"])
    open_store(request.store, create=False).finish(row, [])
    return LogTaskSummary.of(row)


def identify_guarded(address: str, limits: LogTaskLimits) -> LogIdentity:
    """Read vehicle and time of a log, again after what may pass; nothing if that takes too much."""
    answer = _tried(
        lambda _: _process(limits).ask({"identify": address}, min(_IDENTIFY_S, limits.time_s)),
        limits,
    )
    return LogIdentity(answer.get("vehicle", ""), answer.get("time_ns"))


def _tried(ask: Callable[[int], dict[str, Any]], limits: LogTaskLimits) -> dict[str, Any]:
    """Ask up to an answer, or a failure that does not pass."""
    for attempt in range(limits.retries + 1):
        if attempt:
            _STOPPED.wait(_PAUSES_S[min(attempt, len(_PAUSES_S)) - 1])
        answer = ask(attempt + 1)
        if _STOPPED.is_set():
            raise CancelledError
        if answer.get("reason") not in PASSING:
            break
    return answer


def allow_processes() -> None:
    """Let tasks run, after an earlier end."""
    _STOPPED.clear()


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
        self._process = subprocess.Popen(  # noqa: S603 - a module of this package
            [sys.executable, "-m", _SERVER, str(memory_mb)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=os.environ | _ONE_THREAD,
            start_new_session=True,
        )
        _RUNNING.add(self)

    @property
    def is_alive(self) -> bool:
        return self._process.poll() is None

    def ask(self, request: dict[str, Any], time_s: float) -> dict[str, Any]:
        """Return the answer, or the reason why there is none."""
        try:
            line = self._answer(json.dumps(request).encode() + b"\n", time_s)
        except TimeoutError:
            self.end()
            return {"reason": "timeout", "text": f"The log took more than {time_s:g} s."}
        except OSError:
            line = b""
        if not line.endswith(b"\n"):
            return self._death()
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _answer(self, request: bytes, time_s: float) -> bytes:
        assert self._process.stdin and self._process.stdout  # noqa: S101, PT018
        end_s = time.monotonic() + time_s
        self._process.stdin.write(request)
        self._process.stdin.flush()
        line, output = b"", self._process.stdout.fileno()
        while not line.endswith(b"\n"):
            if not select.select([output], [], [], max(0.0, end_s - time.monotonic()))[0]:
                raise TimeoutError
            data = os.read(output, _READ_BYTES)
            if not data:
                break
            line += data
        return line

    def _death(self) -> dict[str, Any]:
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(5.0)
        self.end()
        code = self._process.returncode
        if code is not None and -code in _KILLED:
            return {"reason": "killed", "text": f"The process of the log was killed ({signal.Signals(-code).name})."}
        how = f"signal {signal.Signals(-code).name}" if code is not None and code < 0 else f"code {code}"
        return {"reason": "crashed", "text": f"The process of the log ended with {how}; a library crashed on it."}

    def end(self) -> None:
        """Kill the process and what it started."""
        if self.is_alive:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            with suppress(OSError):
                if stream:
                    stream.close()
        _RUNNING.discard(self)


atexit.register(end_processes)
