# SPDX-License-Identifier: Apache-2.0
"""The directory that a run leaves behind."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from multilica import events
from multilica.config import CalibrationConfig
from multilica.errors import UsageError
from multilica.events import Observer
from multilica.sinks.atomic import begun_files, partial_path, write_text_atomically
from multilica.sinks.report.report_file import REPORT_HTML, ReportFile
from multilica.sinks.rerun_recording import RerunRecording
from multilica.sinks.result_files import CALIBRATION_TOML, RESULT_JSON, ResultFiles
from multilica.sinks.result_mcap import ResultMcap
from multilica.sinks.run_story import RunStory
from multilica.sinks.toml_text import toml_text

__all__ = ["Run", "open_run"]

_CONFIG = "config.toml"
_RECORDING = "recording.rrd"
_MCAP = "result.mcap"
_ATTACHED = (CALIBRATION_TOML, RESULT_JSON, REPORT_HTML)
_CONFIG_HEADER = "# The resolved configuration of a multilica run; give it to --config to run the same again.\n"


class Run:
    """An observer that hands each event to every sink.

    What an earlier run left is removed when this one starts; a result among it only once the new snapshot has proved
    fit, which it has when its clouds are preprocessed. Until then events wait.

    Args:
        directory: where they write.
        config: written as `config.toml` when the calibration starts.
        sinks: in the order in which they are told.
    """

    def __init__(self, directory: Path, config: CalibrationConfig, sinks: Sequence[Observer]) -> None:
        self.directory = directory
        self._config = config
        self._sinks = tuple(sinks)
        self._waiting: list[events.Event] = []
        self._started = False

    def __call__(self, event: events.Event) -> None:
        """Tell every sink, at once or when the snapshot has proved fit."""
        if self._started:
            self._tell(event)
            return
        self._waiting.append(event)
        if self._may_start(event):
            self._start()

    @property
    def started(self) -> bool:
        """Whether anything of this run is on disk."""
        return self._started

    @property
    def keeps_earlier(self) -> bool:
        """Whether the directory holds the result of an earlier run."""
        return not self._started and _holds_result(self.directory)

    def _may_start(self, event: events.Event) -> bool:
        if isinstance(event, events.CalibrationFinished):
            return event.result.refusal is None or not self.keeps_earlier
        return _proves_fit(event) or not self.keeps_earlier

    def _start(self) -> None:
        self.clear()
        text = _CONFIG_HEADER + toml_text(self._config.model_dump(mode="json"))
        write_text_atomically(self.directory / _CONFIG, text)
        self._started = True
        for event in self._waiting:
            self._tell(event)
        self._waiting.clear()

    def _tell(self, event: events.Event) -> None:
        for sink in self._sinks:
            sink(event)

    def clear(self) -> None:
        """Remove what an earlier run left, also what it was writing when it was killed."""
        for path in _outputs(self.directory):
            path.unlink(missing_ok=True)
            for begun in begun_files(path):
                begun.unlink(missing_ok=True)

    @property
    def written(self) -> tuple[Path, ...]:
        """What is there now, the extrinsics first; complete once the `with` block has ended."""
        return tuple(path for path in _outputs(self.directory) if path.exists())


@contextmanager
def open_run(out_dir: Path, config: CalibrationConfig, encoding: str = "foxglove") -> Iterator[Run]:
    """Everything that a calibration leaves on disk, as one observer.

    What an earlier run left in the directory under the same names is removed, so that files of two runs never lie side
    by side; a snapshot that is refused leaves an earlier result as it was.

    Args:
        out_dir: created if it is missing.
        config: the resolved configuration.
        encoding: of `result.mcap`: ``foxglove`` or ``ros2``.

    Raises:
        UsageError: the directory cannot be written to, or holds a `config.toml` of someone else's.
        UnknownNameError: no such encoding.
    """
    _prepare(out_dir)
    story, attached = RunStory(), [out_dir / name for name in _ATTACHED]
    with ExitStack() as stack:
        # Entered first, so closed last: it attaches what the others wrote.
        mcap = stack.enter_context(ResultMcap(out_dir / _MCAP, encoding, attached, story))
        report = stack.enter_context(ReportFile(out_dir, story))
        recording = stack.enter_context(RerunRecording(out_dir / _RECORDING, story))
        files = stack.enter_context(ResultFiles(out_dir, story))
        yield Run(out_dir, config, (recording, mcap, files, report))


def _holds_result(directory: Path) -> bool:
    """Whether an earlier run ended there with an outcome that is more than a refusal."""
    try:
        document = json.loads((directory / RESULT_JSON).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(document, dict) and document.get("refusal") is None


def _proves_fit(event: events.Event) -> bool:
    return isinstance(event, events.StageFinished) and event.stage == "preprocess"


def _outputs(directory: Path) -> tuple[Path, ...]:
    recording, mcap = directory / _RECORDING, directory / _MCAP
    texts = (CALIBRATION_TOML, RESULT_JSON, REPORT_HTML)
    written_last = (recording, partial_path(recording), mcap, partial_path(mcap), directory / _CONFIG)
    return (*(directory / name for name in texts), *written_last)


def _prepare(directory: Path) -> None:
    try:
        directory.mkdir(parents=True, exist_ok=True)
        foreign = _is_foreign(directory / _CONFIG)
    except OSError as error:
        raise _refused(directory, error.strerror or str(error)) from error
    if not os.access(directory, os.W_OK | os.X_OK):
        raise _refused(directory, "permission denied")
    if foreign:
        raise _refused(directory, f"its {_CONFIG} is not of a multilica run and would be lost")


def _is_foreign(config: Path) -> bool:
    if not config.exists():
        return False
    with config.open("rb") as file:
        return file.read(len(_CONFIG_HEADER)) != _CONFIG_HEADER.encode()


def _refused(directory: Path, why: str) -> UsageError:
    return UsageError(f"Cannot write to {directory}: {why}; give --out a directory that can be created or written to.")
