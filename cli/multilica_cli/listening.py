# SPDX-License-Identifier: Apache-2.0
"""Progress of listening to a running vehicle."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn

from multilica_cli.terminal import printable

if TYPE_CHECKING:
    from rich.console import Console

    from multilica.ingest.recording import MessageObserver

__all__ = ["show_listening"]


@contextmanager
def show_listening(console: Console, wanted: int) -> Iterator[MessageObserver]:
    """An observer of messages: a bar per LiDAR on a terminal, a line per LiDAR that is complete elsewhere.

    Args:
        wanted: frames per LiDAR.
    """
    if not console.is_terminal or console.quiet:
        yield _CompleteLines(console, wanted)
        return
    with Progress(
        TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), console=console
    ) as progress:
        yield _Bars(progress, wanted)


class _CompleteLines:
    def __init__(self, console: Console, wanted: int) -> None:
        self._console = console
        self._wanted = wanted

    def __call__(self, topic: str, count: int) -> None:
        if count == self._wanted:
            self._console.print(f"{topic}: {count} of {self._wanted} scans")


class _Bars:
    def __init__(self, progress: Progress, wanted: int) -> None:
        self._progress = progress
        self._wanted = wanted
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, topic: str, count: int) -> None:
        if topic not in self._tasks:
            self._tasks[topic] = self._progress.add_task(printable(topic), total=self._wanted)
        self._progress.update(self._tasks[topic], completed=min(count, self._wanted))
