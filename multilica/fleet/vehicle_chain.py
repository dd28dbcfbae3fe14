# SPDX-License-Identifier: Apache-2.0
"""The logs of one vehicle: decided in order, each against the poses that hold before it, and treated ahead of that.

A log that is treated ahead is verified against the poses that hold so far. If they still hold when its turn comes, its
outcome is that of a run without workers to spare. Else it is treated again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import replace

from multilica.fleet.plan import QueuedLog
from multilica.fleet.store.records import LogRow
from multilica.fleet.store.store import Store
from multilica.fleet.tasks.guard import LogTask

_WITH_POSES = ("verified", "calibrated")
"""States that a log treated ahead may have; others may depend on the bytes of logs before it."""


class VehicleChain:
    """The logs of a vehicle that are not decided yet, and the poses that hold.

    Args:
        logs: in the order of the work.
        make: the task of a log, given the path of the poses that it is verified against.
    """

    def __init__(self, logs: Iterator[QueuedLog], store: Store, make: Callable[[QueuedLog, str], LogTask]) -> None:
        self._logs, self._store, self._make = logs, store, make
        self._started: deque[tuple[LogTask, Future[LogRow]]] = deque()
        self._held: QueuedLog | None = None
        self._again: LogTask | None = None
        self._reference, self._is_steady, self._has_more = "", False, True

    def __len__(self) -> int:
        """Return the number of logs that are started and not decided."""
        return len(self._started) + (self._again is not None)

    def may_go_ahead(self, most: int) -> bool:
        """Return whether the last log left the poses as they were, fewer than `most` are started, and more may be."""
        return self._is_steady and self._has_more and self._held is None and 0 < len(self) < most

    def next_task(self) -> LogTask | None:
        """Return the task of the next log, ahead if others are not decided; None if there is none yet or no more."""
        while (log := self._held or next(self._logs, None)) is not None:
            self._held = None
            if not log.finished:
                return replace(self._make(log, self._reference), ahead=bool(self._started))
            if log.accepted and self._started:  # its poses hold for all that follow
                self._held = log
                return None
            self._reference = log.accepted or self._reference
        self._has_more = False
        return None

    def task_again(self) -> LogTask | None:
        """Return the task of the log whose turn it is, if what was done ahead does not count; else None."""
        task, self._again = self._again, None
        return task

    def add(self, task: LogTask, future: Future[LogRow]) -> Future[LogRow]:
        """Add a started task, at its place in the order; return its future."""
        if task.ahead:
            self._started.append((task, future))
        else:
            self._started.appendleft((task, future))
        return future

    def decide(self) -> Iterator[LogRow]:
        """Yield the rows of finished tasks in the order of the logs, up to one that is to be done again."""
        while self._started and self._started[0][1].done():
            task, future = self._started.popleft()
            row = future.result()
            if task.ahead:
                if task.reference != self._reference or row.state not in _WITH_POSES:
                    self._again = replace(task, ahead=False, reference=self._reference)
                    self._remove_files(row)
                    return
                row = self._settled(task, row)
            before, self._reference = self._reference, row.calibration or self._reference
            self._is_steady = bool(before) and before == self._reference
            yield row

    def _settled(self, task: LogTask, row: LogRow) -> LogRow:
        """Write the row of a log that was treated ahead; return it."""
        first = self._store.first_with(row.source_sha256, task.vehicle, task.config_sha256, task.source)
        if first == task.source:
            self._store.write_log(row)
            return row
        self._remove_files(row)
        copy = replace(row.as_duplicate(first), placed=0, recording="", report="", mcap="", artifacts_mb=0.0)
        copy = replace(copy, calibration=task.reference)
        self._store.finish(copy, [])
        return copy

    def _remove_files(self, row: LogRow) -> None:
        """Remove the files of a calibration that does not count."""
        if row.state == "calibrated":
            for path, _ in list(self._store.files(self._store.run_folder(row.vehicle, row.time_ns, row.key))):
                self._store.remove(path)
