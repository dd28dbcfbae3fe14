# SPDX-License-Identifier: Apache-2.0
"""Progress of a run, of a live recording, of many files or of a fleet on the terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from multilica import events
from multilica_cli.terminal import printable, stderr_console

if TYPE_CHECKING:
    from multilica.config import IngestConfig
    from multilica.fleet.fleet_run import FleetObserver, FleetOutcome
    from multilica.fleet.store.records import LogRow
    from multilica.ingest.locate import PathLike
    from multilica.ingest.recording import MessageObserver

_COLUMNS = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())


@contextmanager
def show_progress(*, quiet: bool) -> Iterator[events.RunObserver]:
    """Show the stages of a run on stderr: as bars on a terminal, else as a line per finished stage."""
    console = stderr_console(quiet=quiet)
    if quiet or not console.is_terminal:
        yield lambda event: _print_event(event, console)
        return
    bars = _StageBars(console)
    try:
        yield bars
    finally:
        bars.stop()


def _print_event(event: events.RunEvent, console: Console) -> None:
    match event:
        case events.StageFinished(stage, elapsed_s):
            console.print(f"{stage:<10} {elapsed_s:7.2f} s")
        case events.SnapshotStarted(name):
            console.print(f"snapshot {name}")
        case events.StopsProgressed("read stops" as doing, done, total) if done == total:
            console.print(f"{doing}: {total}")
        case events.InputNoted(note):
            console.print(f"note: {note}")
        case events.SnapshotRefused(_, reason):
            console.print(f"left out: {reason}")


_STAGE_OF: Mapping[type, str] = {
    events.CorrespondencesMatched: "correspond",
    events.HypothesesFound: "coarse",
    events.HypothesesVerified: "verify",
}
"""The stage of events that come while further stages run."""


class _StageBars:
    """An observer with a bar per stage; each snapshot starts a new block of bars."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._progress: Progress | None = None
        self._tasks: dict[str, TaskID] = {}
        self._stage = ""

    def __call__(self, event: events.RunEvent) -> None:
        match event:
            case events.StageStarted(stage, steps):
                self._stage = stage
                self._tasks[stage] = self._started().add_task(f"{stage:<10}", total=steps or None)
            case events.StageFinished(stage):
                bars, task = self._started(), self._tasks[stage]
                done = max(bars.tasks[bars.task_ids.index(task)].completed, 1)
                bars.update(task, total=done, completed=done)
            case events.SnapshotStarted():
                self.stop()
                _print_event(event, self._console)
            case events.StopsProgressed(doing, done, total):
                if doing not in self._tasks:
                    self._tasks[doing] = self._started().add_task(f"{doing:<10}", total=total)
                self._started().update(self._tasks[doing], total=total, completed=done)
            case events.InputNoted() | events.SnapshotRefused():
                _print_event(event, self._console)
            case events.CalibrationStarted() | events.CalibrationFinished():
                pass
            case _:
                of_event = _STAGE_OF.get(type(event), self._stage)
                self._started().advance(self._tasks.get(of_event, self._tasks[self._stage]))

    def _started(self) -> Progress:
        if self._progress is None:
            self._progress = Progress(SpinnerColumn(finished_text=" "), *_COLUMNS, console=self._console)
            self._progress.start()
        return self._progress

    def stop(self) -> None:
        """Leave the bars as they are."""
        if self._progress is not None:
            self._progress.stop()
            self._progress = None


def tell_listening(sources: Sequence[PathLike], config: IngestConfig, *, quiet: bool) -> None:
    """Print on stderr what is waited for, if the source is a running vehicle."""
    from multilica.ingest import live_address

    if live_address(sources):
        listening = f"listening for {config.frames} scans of each LiDAR, at most {config.timeout_s:g} s"
        stderr_console(quiet=quiet).print(listening)


@contextmanager
def show_listening(wanted: int, *, quiet: bool) -> Iterator[MessageObserver]:
    """Show on stderr how many of the wanted frames arrived: as a bar per topic, else as a line per complete topic."""
    console = stderr_console(quiet=quiet)
    if quiet or not console.is_terminal:
        yield lambda topic, count: console.print(f"{topic}: {count} of {wanted} scans") if count == wanted else None
        return
    tasks: dict[str, TaskID] = {}
    with Progress(*_COLUMNS[:3], console=console) as progress:

        def observe(topic: str, count: int) -> None:
            if topic not in tasks:
                tasks[topic] = progress.add_task(printable(topic), total=wanted)
            progress.update(tasks[topic], completed=min(count, wanted))

        yield observe


@contextmanager
def show_count(name: str, total: int) -> Iterator[Callable[[], None]]:
    """Show on stderr how many of a known number are done: as a bar on a terminal, else as a line per tenth."""
    console = stderr_console()
    if console.is_terminal:
        with Progress(*_COLUMNS, console=console) as progress:
            task = progress.add_task(name, total=total)
            yield lambda: progress.advance(task)
        return
    done = 0

    def advance() -> None:
        nonlocal done
        done += 1
        if done * 10 // total > (done - 1) * 10 // total:
            console.print(f"{done} of {total} {name}")

    yield advance


@contextmanager
def show_fleet(*, quiet: bool) -> Iterator[FleetObserver]:
    """Show on stderr how far the run is, its rate and failures, and a line for each log without a result."""
    from multilica.fleet.fleet_run import FleetOutcome

    console = stderr_console(quiet=quiet)
    columns = (
        SpinnerColumn(finished_text=" "),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TaskProgressColumn(text_format="", show_speed=True),
        TimeElapsedColumn(),
        TextColumn("ETA"),
        TimeRemainingColumn(),
    )
    bars = Progress(*columns, console=console, disable=quiet or not console.is_terminal)
    task, bad, done, to_do = bars.add_task("finding logs", total=None), 0, 0, 0

    def observe(event: FleetOutcome | LogRow) -> None:
        nonlocal bad, done, to_do
        if isinstance(event, FleetOutcome):
            to_do = event.found - event.skipped
            bars.update(task, total=to_do, description="logs")
            console.print(f"{event.found} logs, {event.skipped} of them finished before.")
            if event.unlike_pattern:
                told = f"note: logs that the pattern does not fit: {event.unlike_pattern}"
                console.print(f"{told}; their vehicle is from the manifest, the log or its folder.")
            return
        done += 1
        if event.state in ("refused", "failed"):
            bad += 1
            console.print(f"{event.vehicle}: {event.source}: {event.state}: {event.reason_text}")
        elif bars.disable and done % max(1, to_do // 20) == 0:
            console.print(f"{done} of {to_do} logs, {bad} without a result")
        bars.update(task, completed=done, description=f"logs, {bad} without a result" if bad else "logs")

    with bars:
        yield observe
