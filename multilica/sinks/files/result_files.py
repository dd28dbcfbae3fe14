# SPDX-License-Identifier: Apache-2.0
"""Sink that writes `result.json` and `calibration.toml`."""

from pathlib import Path

from multilica import events
from multilica.sinks.files.atomic import write_text_atomically
from multilica.sinks.files.calibration_toml import calibration_toml
from multilica.sinks.files.result_document import run_document
from multilica.sinks.run_state import RunState

RESULT_JSON = "result.json"
CALIBRATION_TOML = "calibration.toml"


class ResultFiles:
    """A sink that writes `result.json` and `calibration.toml` once the calibration has finished.

    Args:
        directory: an existing directory; files of these names in it are replaced.
        state: shared with other sinks of the run; its own if there are none.
    """

    def __init__(self, directory: Path, state: RunState | None = None) -> None:
        self.directory = directory
        self._state = state if state is not None else RunState()

    def __call__(self, event: events.Event) -> None:
        """Take in an event; write at the last one."""
        self._state(event)
        if not isinstance(event, events.CalibrationFinished):
            return
        document = run_document(self._state)
        if document is not None:
            write_text_atomically(self.directory / RESULT_JSON, f"{document.model_dump_json(indent=2)}\n")
            write_text_atomically(self.directory / CALIBRATION_TOML, calibration_toml(document))
