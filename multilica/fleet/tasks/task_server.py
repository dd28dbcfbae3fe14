# SPDX-License-Identifier: Apache-2.0
"""The process that tasks run in: a request per line on stdin, an answer per line on stdout.

It ends when stdin does, so never outlives the process that started it.
"""

from __future__ import annotations

import json
import os
import queue
import resource
import signal
import sys
import threading
from pathlib import Path
from typing import Any

MAX_LINE_BYTES = 4 << 20


def main() -> None:
    """Answer requests until stdin ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the driver ends it
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what a library prints is no answer
    requests: queue.SimpleQueue[str] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(requests,), daemon=True).start()

    from multilica.fleet.tasks import run_task

    _limit_memory(float(sys.argv[1]))
    while True:
        request = json.loads(requests.get())
        try:
            answer = _answer(request, run_task)
        except MemoryError:
            answer = {"reason": "memory", "text": "The log takes more memory than a task may have."}
        except Exception as failure:  # noqa: BLE001 - one log must not end the others
            text = f"This is a bug in multilica, not in the log ({type(failure).__name__}: {failure})."
            answer = {"reason": "bug", "text": text[:500]}
        print(json.dumps(answer), file=answers, flush=True)


def _answer(request: dict[str, Any], run_task: Any) -> dict[str, Any]:  # noqa: ANN401 - a module that takes time to load
    from multilica.fleet.tasks.log_task import LogTask
    from multilica.ingest.metadata import identify_log
    from multilica.ingest.remote.remote_file import ConnectionLostError

    try:
        if "identify" in request:
            identity = identify_log(request["identify"])
            return {"vehicle": identity.vehicle, "time_ns": identity.time_ns}
        return {"summary": run_task.run_log_task(_below_folder(LogTask.model_validate(request["task"]))).model_dump()}
    except ConnectionLostError as failure:
        return {"reason": "network", "text": str(failure)}


def _below_folder(request: Any) -> Any:  # noqa: ANN401 - as above
    """Read a local log by its path below what was given, so that files and tables hold no path of the machine."""
    folder = request.address.removesuffix(request.source)
    if folder not in {"", request.address} and Path(folder).is_dir():
        os.chdir(folder)
        return request.model_copy(update={"address": request.source})
    return request


def _read(requests: queue.SimpleQueue[str]) -> None:
    for line in sys.stdin:
        requests.put(line)
    os._exit(0)


def _limit_memory(limit_mb: float) -> None:
    """Allow so much on top of what the libraries take."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    most = pages * resource.getpagesize() + round(limit_mb * 1e6)
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


if __name__ == "__main__":
    main()
