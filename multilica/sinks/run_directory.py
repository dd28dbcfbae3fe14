# SPDX-License-Identifier: Apache-2.0
"""Output directory of a run."""

import json
import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from multilica import events
from multilica.config import CalibrationConfig
from multilica.errors import UsageError
from multilica.events import Observer
from multilica.sinks.files.atomic import begun_files, partial_path, write_text_atomically
from multilica.sinks.files.calibration_toml import toml_text
from multilica.sinks.files.result_files import CALIBRATION_TOML, RESULT_JSON, ResultFiles
from multilica.sinks.mcap.result_mcap import ResultMcap
from multilica.sinks.report.page import REPORT_HTML, ReportFile
from multilica.sinks.rerun.recording import RerunRecording
from multilica.sinks.run_state import RunState

__all__ = ["RunDirectory", "open_run"]

_CONFIG = "config.toml"
_RECORDING = "recording.rrd"
_MCAP = "result.mcap"
_ATTACHED = (CALIBRATION_TOML, RESULT_JSON, REPORT_HTML)
_CONFIG_HEADER = "# The resolved configuration of a multilica run; give it to --config to run the same again.\n"


class RunDirectory:
    """An observer that passes each event to every sink.

    The files of an earlier run are removed first. If they include a result, events are queued until the clouds of the
    new snapshot are preprocessed: a refused snapshot does not replace an earlier result.

    Args:
        directory: output directory of the sinks.
        config: written as `config.toml` when the calibration starts.
        sinks: called in this order.

    Attributes:
        started: whether anything of this run is on disk.
    """

    def __init__(self, directory: Path, config: CalibrationConfig, sinks: Sequence[Observer]) -> None:
        self.directory = directory
        self.started = False
        self._config = config
        self._sinks = tuple(sinks)
        self._queue: list[events.Event] = []

    def __call__(self, event: events.Event) -> None:
        """Pass the event to every sink, at once or when the clouds are preprocessed."""
        self._queue.append(event)
        if not self.started:
            if not self._may_start(event):
                return
            self.clear()
            text = _CONFIG_HEADER + toml_text(self._config.model_dump(mode="json"))
            write_text_atomically(self.directory / _CONFIG, text)
            self.started = True
        queued, self._queue = self._queue, []
        for each in queued:
            for sink in self._sinks:
                sink(each)

    @property
    def keeps_earlier(self) -> bool:
        """Return whether the directory has the result of an earlier run."""
        return not self.started and _holds_result(self.directory)

    def _may_start(self, event: events.Event) -> bool:
        match event:
            case events.StageFinished("preprocess"):
                return True
            case events.CalibrationFinished(result) if result.refusal is None:
                return True
        return not self.keeps_earlier

    def clear(self) -> None:
        """Remove the files of an earlier run, including partly written ones of a killed run."""
        for path in _outputs(self.directory):
            path.unlink(missing_ok=True)
            for begun in begun_files(path):
                begun.unlink(missing_ok=True)

    @property
    def written(self) -> tuple[Path, ...]:
        """Return the files so far, the extrinsics first; complete after the `with` block."""
        return tuple(path for path in _outputs(self.directory) if path.exists())


@contextmanager
def open_run(out_dir: Path, config: CalibrationConfig, encoding: str = "foxglove") -> Iterator[RunDirectory]:
    """Open the output directory of a run as one observer.

    Files of an earlier run in the directory are removed; a refused snapshot leaves an earlier result unchanged. An
    exception that ends the run gets a note that says what the directory has.

    Args:
        out_dir: created if it is missing.
        config: the resolved configuration.
        encoding: of `result.mcap`: ``foxglove`` or ``ros2``.

    Raises:
        UsageError: the directory is not writable, or has a `config.toml` that is not of multilica.
        UnknownNameError: no such encoding.
    """
    _prepare(out_dir)
    state, attached = RunState(), [out_dir / name for name in _ATTACHED]
    with ExitStack() as stack:
        # Entered first, so closed last: it attaches what the others wrote.
        mcap = stack.enter_context(ResultMcap(out_dir / _MCAP, encoding, attached, state))
        report = stack.enter_context(ReportFile(out_dir, state))
        recording = stack.enter_context(RerunRecording(out_dir / _RECORDING, state))
        files = ResultFiles(out_dir, state)
        run = RunDirectory(out_dir, config, (recording, mcap, files, report))
        try:
            yield run
        except BaseException as error:
            if run.started:
                error.add_note(f"The recording so far is in {out_dir}; see `multilica explain {out_dir}`.")
            elif run.keeps_earlier:
                error.add_note(f"The earlier result in {out_dir} is unchanged.")
            raise


def _holds_result(directory: Path) -> bool:
    """Return whether an earlier run left a result that is not a refusal."""
    try:
        document = json.loads((directory / RESULT_JSON).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(document, dict) and document.get("refusal") is None


def _outputs(directory: Path) -> tuple[Path, ...]:
    texts = tuple(directory / name for name in _ATTACHED)
    recording, mcap = directory / _RECORDING, directory / _MCAP
    return (*texts, recording, partial_path(recording), mcap, partial_path(mcap), directory / _CONFIG)


def _prepare(directory: Path) -> None:
    config, why = directory / _CONFIG, ""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        foreign = config.exists() and not config.read_bytes().startswith(_CONFIG_HEADER.encode())
        if not os.access(directory, os.W_OK | os.X_OK):
            why = "permission denied"
        elif foreign:
            why = f"its {_CONFIG} is not of a multilica run and would be overwritten"
    except OSError as error:
        why = error.strerror or str(error)
    if why:
        raise UsageError(
            f"Cannot write to {directory}: {why}; give --out a directory that can be created or written to."
        )
