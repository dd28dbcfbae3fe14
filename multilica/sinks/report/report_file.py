# SPDX-License-Identifier: Apache-2.0
"""Sink that writes `report.html`."""

from pathlib import Path
from types import TracebackType
from typing import Self

from multilica import events
from multilica.sinks.files.atomic import write_text_atomically
from multilica.sinks.run_state import RunState

__all__ = ["REPORT_HTML", "ReportFile"]

REPORT_HTML = "report.html"


class ReportFile:
    """A sink that writes `report.html` when the run is over, however it ended.

    Args:
        directory: an existing directory; a report in it is replaced.
        state: shared with other sinks of the run.
    """

    def __init__(self, directory: Path, state: RunState | None = None) -> None:
        self.directory = directory
        self._state = state if state is not None else RunState()
        self._written = False

    def __enter__(self) -> Self:
        return self

    def __call__(self, event: events.Event) -> None:
        """Update the state; write the report after the last event."""
        self._state(event)
        if isinstance(event, events.CalibrationFinished):
            self._write()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Write the report of a run that started and has no result."""
        if self._state.snapshot is not None and not self._written:
            self._write(f"{error}" if error is not None and f"{error}" else "The run was stopped early.")

    def _write(self, ended_early: str = "") -> None:
        from multilica.sinks.report.contents import contents_of
        from multilica.sinks.report.page import report_html

        write_text_atomically(self.directory / REPORT_HTML, report_html(contents_of(self._state, ended_early)))
        self._written = True
