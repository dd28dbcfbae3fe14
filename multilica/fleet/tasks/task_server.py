# SPDX-License-Identifier: Apache-2.0
"""The process that tasks run in: it answers what comes over a connection.

It ends when its stdin does, so never outlives the process that started it.
"""

from __future__ import annotations

import os
import resource
import signal
import sys
import threading
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from multilica.fleet.tasks.guard import LogTask


def main() -> None:
    """Answer requests until stdin ends: a LogTask with its row, the address of a log with its LogIdentity."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the driver ends it
    threading.Thread(target=_end_with_stdin, daemon=True).start()

    from multilica.fleet.tasks import run_task

    _limit_memory(float(sys.argv[2]))
    with Connection(int(sys.argv[1])) as requests:
        while True:
            requests.send(_answer(requests.recv(), run_task))


def _answer(request: LogTask | str, run_task: Any) -> object:  # noqa: ANN401 - a module that takes time to load
    from multilica.fleet.tasks.guard import LogTaskFailure
    from multilica.ingest.metadata import identify_log
    from multilica.ingest.remote.remote_file import ConnectionLostError

    try:
        return identify_log(request) if isinstance(request, str) else run_task.run_log_task(_below_folder(request))
    except ConnectionLostError as failure:
        return LogTaskFailure("network", str(failure))
    except MemoryError:
        return LogTaskFailure("memory", "The log takes more memory than a task may have.")
    except Exception as failure:  # noqa: BLE001 - one log must not end the others
        text = f"This is a bug in multilica, not in the log ({type(failure).__name__}: {failure})."
        return LogTaskFailure("bug", text[:500])


def _below_folder(request: LogTask) -> LogTask:
    """Read a local log by its path below what was given, so that files and tables hold no path of the machine."""
    folder = request.address.removesuffix(request.source)
    if folder not in {"", request.address} and Path(folder).is_dir():
        os.chdir(folder)
        return request.model_copy(update={"address": request.source})
    return request


def _end_with_stdin() -> None:
    sys.stdin.read()
    os._exit(0)


def _limit_memory(limit_mb: float) -> None:
    """Allow so much on top of what the libraries take."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    most = pages * resource.getpagesize() + round(limit_mb * 1e6)
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


if __name__ == "__main__":
    main()
