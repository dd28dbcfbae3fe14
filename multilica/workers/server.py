# SPDX-License-Identifier: Apache-2.0
"""A process that imports modules once and forks the workers, and what a worker does."""

import gc
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from importlib import import_module

from multilica.allocator import keep_freed_memory
from multilica.workers.messages import UNREADABLE, Answer, Job, Release, Shared, WorkerFailure, claim_next, pack, unpack

# Read by OpenMP, OpenBLAS and MKL when they are loaded. OpenBLAS and MKL fall back to the first.
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def start_server(control: socket.socket, modules: Sequence[str]) -> subprocess.Popen[bytes]:
    """Start the process, without waiting for it.

    Args:
        control: each socket that is sent through it is served by a new worker; when its other end is closed, the
            server ends with all its workers.
        modules: imported once, before the first worker is forked.
    """
    # The main module of the caller is not imported: it may be a script that runs on import.
    command = (
        f"import sys; sys.path[:] = {sys.path!r}; "
        f"from multilica.workers.server import serve; serve({control.fileno()}, {list(modules)!r})"
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
            _send(caller, pack(Answer(UNREADABLE, 0, WorkerFailure.of(error))))
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
    _send(caller, buffer)


def _send(caller: socket.socket, buffer: int) -> None:
    socket.send_fds(caller, [b"."], [buffer])
    os.close(buffer)
