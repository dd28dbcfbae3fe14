# SPDX-License-Identifier: Apache-2.0
"""Output directory of a run."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from multilica import events
from multilica.config import CalibrationConfig
from multilica.events import Observer
from multilica.sinks.files.atomic import write_text_atomically
from multilica.sinks.files.result_files import ResultFiles, config_toml
from multilica.sinks.files.run_files import (
    ATTACHED,
    CONFIG_HEADER,
    CONFIG_TOML,
    MCAP,
    RECORDING,
    locked,
    outputs,
    place_for_run,
    prepare,
    publish,
    remove_outputs,
)
from multilica.sinks.mcap.result_mcap import ResultMcap
from multilica.sinks.report.page import ReportFile
from multilica.sinks.rerun.recording import RerunRecording
from multilica.sinks.run_state import RunState


class RunDirectory:
    """An observer that passes each event to every sink.

    Args:
        directory: of the whole run.
        place: where the sinks write: the directory itself, or `unfinished` in it while it holds an earlier result.
        config: written as `config.toml` before the first event.
        sinks: called in this order.

    Attributes:
        started: whether anything of this run is on disk.
        has_result: whether the calibration finished and the snapshot was not refused.
    """

    def __init__(self, directory: Path, place: Path, config: CalibrationConfig, sinks: Sequence[Observer]) -> None:
        self.directory = directory
        self.place = place
        self.started = False
        self.has_result = False
        self._config = config
        self._sinks = tuple(sinks)

    def __call__(self, event: events.Event) -> None:
        """Pass the event to every sink."""
        if not self.started:
            self.start()
        if isinstance(event, events.CalibrationFinished):
            self.has_result = event.result.refusal is None
        for sink in self._sinks:
            sink(event)

    def start(self) -> None:
        """Remove what an unfinished run left, and write the configuration."""
        remove_outputs(self.place)
        self.place.mkdir(exist_ok=True)
        write_text_atomically(self.place / CONFIG_TOML, CONFIG_HEADER + config_toml(self._config))
        self.started = True

    @property
    def keeps_earlier(self) -> bool:
        """True if the directory holds the result of an earlier run."""
        return self.place != self.directory

    @property
    def written(self) -> tuple[Path, ...]:
        """Return the files so far, the extrinsics first; complete after the `with` block."""
        place = self.place if self.place.exists() else self.directory
        return tuple(path for path in outputs(place) if path.exists())


@contextmanager
def open_run(out_dir: Path, config: CalibrationConfig, encoding: str = "foxglove") -> Iterator[RunDirectory]:
    """Open the output directory of a run as one observer.

    The directory is locked until the block ends. While it holds an earlier result, the files are written into
    `unfinished` in it, and take the place of the earlier ones when all are whole. A refused or interrupted run stays
    there until the next one. An exception that ends the run gets a note that says what the directory has.

    Args:
        out_dir: created if it is missing.
        config: the resolved configuration.
        encoding: of `result.mcap`: ``foxglove`` or ``ros2``.

    Raises:
        UsageError: the directory is not writable, is in use by another run, or has a `config.toml` that is not of
            multilica.
        UnknownNameError: no such encoding.
    """
    prepare(out_dir)
    with locked(out_dir), ExitStack() as stack:
        place, state = place_for_run(out_dir), RunState()
        # Entered first, so closed last: it attaches what the others wrote.
        attached = [place / name for name in ATTACHED]
        mcap = stack.enter_context(ResultMcap(place / MCAP, encoding, attached, state))
        report = stack.enter_context(ReportFile(place, state))
        recording = stack.enter_context(RerunRecording(place / RECORDING, state))
        run = RunDirectory(out_dir, place, config, (recording, mcap, ResultFiles(place, state), report))
        try:
            yield run
        except BaseException as error:
            if run.keeps_earlier:
                error.add_note(f"The earlier result in {out_dir} is unchanged.")
            if run.started:
                error.add_note(f"The recording so far is in {place}; see `multilica explain {place}`.")
            raise
        stack.close()
        if run.keeps_earlier and run.has_result:
            publish(out_dir)
