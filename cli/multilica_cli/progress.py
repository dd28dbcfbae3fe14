# SPDX-License-Identifier: Apache-2.0
"""Events as progress on the terminal."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

from multilica.events import CalibrationFinished, CalibrationStarted, Event, Observer, StageFinished, StageStarted

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["show_progress"]


@contextmanager
def show_progress(console: Console) -> Iterator[Observer]:
    """An observer that shows the stages: bars on a terminal, a line per finished stage elsewhere."""
    if not console.is_terminal or console.quiet:
        yield _StageLines(console)
        return
    columns = (
        SpinnerColumn(finished_text=" "),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console) as progress:
        yield _StageBars(progress)


class _StageLines:
    def __init__(self, console: Console) -> None:
        self._console = console

    def __call__(self, event: Event) -> None:
        if isinstance(event, StageFinished):
            self._console.print(f"{event.stage:<10} {event.elapsed_s:7.2f} s")


class _StageBars:
    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._task: TaskID | None = None

    def __call__(self, event: Event) -> None:
        match event:
            case StageStarted(stage, steps):
                self._task = self._progress.add_task(f"{stage:<10}", total=steps or None)
            case StageFinished():
                self._finish()
            case CalibrationStarted() | CalibrationFinished():
                pass
            case _:
                self._advance()

    def _advance(self) -> None:
        if self._task is not None:
            self._progress.advance(self._task)

    def _finish(self) -> None:
        if self._task is not None:
            done = self._progress.tasks[self._task].completed
            self._progress.update(self._task, total=max(done, 1), completed=max(done, 1))
            self._task = None
