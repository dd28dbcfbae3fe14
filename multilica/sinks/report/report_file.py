# SPDX-License-Identifier: Apache-2.0
"""A calibration as a page for people."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Self

from multilica import events
from multilica.sinks.atomic import write_text_atomically
from multilica.sinks.run_story import RunStory

__all__ = ["REPORT_HTML", "ReportFile"]

REPORT_HTML = "report.html"


class ReportFile:
    """A sink that writes `report.html` when the run is over, however it ended.

    Args:
        directory: an existing directory; a report in it is replaced.
        story: shared with other sinks of the run; its own if there are none.
    """

    def __init__(self, directory: Path, story: RunStory | None = None) -> None:
        self.directory = directory
        self._story = story if story is not None else RunStory()
        self._written = False

    def __enter__(self) -> Self:
        return self

    def __call__(self, event: events.Event) -> None:
        """Remember an event; the last one is written."""
        self._story(event)
        if isinstance(event, events.CalibrationFinished):
            self._write()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Tell of a run that had started and came to no result."""
        if self._story.snapshot is not None and not self._written:
            self._write(f"{error}" if error is not None and f"{error}" else "It was stopped before it was done.")

    def _write(self, ended_early: str = "") -> None:
        from multilica.sinks.report.contents import contents_of
        from multilica.sinks.report.page import report_html

        write_text_atomically(self.directory / REPORT_HTML, report_html(contents_of(self._story, ended_early)))
        self._written = True
