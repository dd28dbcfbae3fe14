# SPDX-License-Identifier: Apache-2.0
"""Progress of a run over a fleet's logs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from multilica_cli.terminal import stderr_console

if TYPE_CHECKING:
    from multilica.fleet.fleet_run import LogFinished, LogsPlanned

_BAD = ("refused", "failed")


@contextmanager
def show_fleet(*, quiet: bool) -> Iterator[Callable[[LogsPlanned | LogFinished], None]]:
    """Show on stderr how far the run is, its rate and failures, and a line for each log without a result."""
    from multilica.fleet.fleet_run import LogsPlanned

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

    def observe(event: LogsPlanned | LogFinished) -> None:
        nonlocal bad, done, to_do
        if isinstance(event, LogsPlanned):
            to_do = event.to_do
            bars.update(task, total=to_do, description="logs")
            console.print(f"{event.found} logs, {event.found - to_do} of them finished before.")
            return
        done += 1
        row = event.row
        if row.state in _BAD:
            bad += 1
            console.print(f"{row.vehicle}: {row.source}: {row.state}: {row.reason_text}")
        elif bars.disable and done % max(1, to_do // 20) == 0:
            console.print(f"{done} of {to_do} logs, {bad} without a result")
        bars.update(task, completed=done, description=f"logs, {bad} without a result" if bad else "logs")

    with bars:
        yield observe
