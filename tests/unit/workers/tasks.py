# SPDX-License-Identifier: Apache-2.0
"""Tasks for worker processes."""

import os
import signal
import time
from pathlib import Path

import numpy as np

from multilica.errors import MissingDependencyError, UnfitSnapshotError, UnknownNameError


def square(_, item):
    return item * item


def nap(_, seconds):
    time.sleep(seconds)
    return seconds


def processes(_, item):
    """Of the worker and its server."""
    time.sleep(0.05)  # so that none takes all
    return os.getpid(), os.getppid(), item


def scaled(shared, factor):
    return factor * shared["cloud"]


def scaled_by(_, item):
    cloud, factor = item
    return factor * cloud


def total_of(shared, name):
    return float(shared[name].sum())


def layout(shared, array):
    cloud = shared["cloud"]
    return cloud.flags.f_contiguous, cloud.flags.writeable, array.flags.writeable, array.shape


def total(shared, _):
    return float(shared["cloud"].sum())


def threads(*_):
    np.ones((300, 300)) @ np.ones((300, 300))
    return len(list(Path("/proc/self/task").iterdir()))


def fail(_, kind):
    match kind:
        case "missing":
            raise MissingDependencyError("It is not installed.")
        case "unknown":
            raise UnknownNameError("preset", "papper", ["paper"], "here")
        case "unfit":
            raise UnfitSnapshotError("It moves.", code="moving_vehicle")
        case "system":
            raise OSError(28, "No space left on device", "file")
        case "local":
            raise type("LocalError", (Exception,), {})("from here")
        case "unpicklable":
            return lambda: 0
    return kind


def die(_, item):
    if item == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return item


class Unreadable:
    """A value that cannot be read by another process."""

    def __reduce__(self):
        return _refuse, ()


def _refuse():
    raise ImportError("libGL.so.1: cannot open shared object file")
