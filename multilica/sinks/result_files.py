# SPDX-License-Identifier: Apache-2.0
"""The outcome of a calibration as files that programs and people read."""

from __future__ import annotations

import json
from pathlib import Path
from types import TracebackType
from typing import Self

from multilica import events
from multilica.results import CalibrationResult
from multilica.sinks.atomic import write_text_atomically
from multilica.sinks.calibration_toml import calibration_toml
from multilica.sinks.result_document import result_document
from multilica.sinks.run_document import run_document
from multilica.sinks.run_story import RunStory

__all__ = ["CALIBRATION_TOML", "RESULT_JSON", "ResultFiles", "result_document"]

RESULT_JSON = "result.json"
CALIBRATION_TOML = "calibration.toml"


class ResultFiles:
    """A sink that writes `result.json` and `calibration.toml` once the calibration has finished.

    Args:
        directory: an existing directory; files of these names in it are replaced.
        story: shared with other sinks of the run; its own if there are none.
    """

    def __init__(self, directory: Path, story: RunStory | None = None) -> None:
        self.directory = directory
        self._story = story if story is not None else RunStory()

    def __enter__(self) -> Self:
        return self

    def __call__(self, event: events.Event) -> None:
        """Remember an event; write at the last one."""
        self._story(event)
        if isinstance(event, events.CalibrationFinished):
            self._write(event.result)

    def _write(self, result: CalibrationResult) -> None:
        document, provenance = run_document(self._story), self._story.provenance
        if document is None or provenance is None:
            return
        text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)
        write_text_atomically(self.directory / RESULT_JSON, f"{text}\n")
        write_text_atomically(self.directory / CALIBRATION_TOML, calibration_toml(result, provenance))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Nothing is open."""
