# SPDX-License-Identifier: Apache-2.0
"""A task server whose logs crash, hang or take memory, as the first word of their name says."""

import errno
import os
import signal
import time
from pathlib import Path

import numpy as np

from multilica.errors import StorageError, UnreadableSourceError
from multilica.fleet.store.store import open_store
from multilica.fleet.tasks import run_task
from multilica.fleet.tasks.guard import failed_row
from multilica.ingest import metadata
from multilica.ingest.remote.remote_file import ConnectionLostError

ERRORS = {
    "bug": ZeroDivisionError("nothing to divide by"),
    "broken": UnreadableSourceError("never reached by the server of the library"),
    "full": OSError(errno.ENOSPC, "No space left on device", "scratch"),
    "refusing": StorageError("The store refuses."),
    "unreachable": ConnectionLostError("The connection was lost."),
}


def run_log_task(request):
    what, tried = request.source.split("-")[0], Path(f"{request.address}.tried")
    match what:
        case "crash":
            os.abort()
        case "hang":
            time.sleep(1000.0)
        case "memory":
            np.ones(10**11)
        case "killed" if not tried.exists():
            tried.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        case "offline" if not tried.exists():
            tried.touch()
            raise ConnectionLostError("The connection was lost.")
        case "away" if not tried.exists():
            tried.touch()
            raise StorageError("The store does not answer.", passes=True)
        case _ if what in ERRORS:
            raise ERRORS[what]
    print("what a library prints is no answer")
    row = failed_row(request, "stub", f"process {os.getpid()}", state="refused")
    open_store(request.store, create=False).finish(row, [])
    return row


def identify_log(address):
    tried = Path(f"{address}.tried")
    if "killed" in address and not tried.exists():
        tried.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if "offline" in address and not tried.exists():
        tried.touch()
        raise ConnectionLostError("The connection was lost.")
    if "full" in address:
        raise ERRORS["full"]
    return metadata.LogIdentity("v7", 7)


if __name__ == "__main__":
    run_task.identify_log = identify_log
    run_task.run_log_task = run_log_task
    run_task.main()
