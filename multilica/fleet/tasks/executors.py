# SPDX-License-Identifier: Apache-2.0
"""Executors of log tasks: threads that each keep a process, or the workers of a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

from multilica.errors import SourceNotFoundError, UsageError
from multilica.fleet.tasks.guard import allow_processes, end_processes
from multilica.optional_libraries import needed_for

_SCHEMES = ("tcp://", "tls://", "ws://", "wss://")
_CONNECT_S = 30


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
        allow_processes()
        with ThreadPoolExecutor(workers, thread_name_prefix="log-task") as pool:
            try:
                yield pool, workers
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
            finally:
                end_processes()
        return
    if not scheduler.startswith(_SCHEMES):
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
        client = _connected(lambda: Client(scheduler, timeout=_CONNECT_S, security=security, set_as_default=False))
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
