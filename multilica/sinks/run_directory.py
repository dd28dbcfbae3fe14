# SPDX-License-Identifier: Apache-2.0
"""Output directory of a run."""

import fcntl
import json
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from multilica import events
from multilica.config import CalibrationConfig
from multilica.documents import MAX_JSON_BYTES, DocumentError, parse_json, read_limited
from multilica.errors import UsageError
from multilica.events import Observer
from multilica.sinks.files.atomic import begun_files, partial_path, write_text_atomically
from multilica.sinks.files.result_files import (
    CALIBRATION_TOML,
    MCAP,
    REPORT_HTML,
    RESULT_JSON,
    ResultFiles,
    config_toml,
)
from multilica.sinks.mcap.result_mcap import ResultMcap
from multilica.sinks.report.page import ReportFile
from multilica.sinks.rerun.recording import RerunRecording
from multilica.sinks.run_state import RunState

CONFIG_TOML = "config.toml"
RECORDING = "recording.rrd"
UNFINISHED = "unfinished"
ATTACHED = (CALIBRATION_TOML, RESULT_JSON, REPORT_HTML)
CONFIG_HEADER = "# The resolved configuration of a multilica run; give it to --config to run the same again.\n"

# Lists the entries of a whole run that are about to take the place of the earlier one.
_WHOLE = ".whole.json"


def outputs(directory: Path) -> tuple[Path, ...]:
    """Return the paths of all files that a run can leave, the extrinsics first."""
    texts = tuple(directory / name for name in ATTACHED)
    recording, mcap = directory / RECORDING, directory / MCAP
    return (*texts, recording, partial_path(recording), mcap, partial_path(mcap), directory / CONFIG_TOML)


def prepare(directory: Path) -> None:
    """Create a run directory.

    Raises:
        UsageError: it cannot be written to, or holds files of the user's own in the way of a run's.
    """
    why = ""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        unfinished = directory / UNFINISHED
        if not os.access(directory, os.W_OK | os.X_OK):
            why = "permission denied"
        elif _is_foreign(directory / CONFIG_TOML):
            why = f"its {CONFIG_TOML} is not of a multilica run and would be overwritten"
        elif unfinished.exists() and not _is_unfinished_run(unfinished):
            why = f"its '{UNFINISHED}' is not of a multilica run and would be overwritten"
    except OSError as error:
        why = error.strerror or str(error)
    if why:
        raise UsageError(
            f"Cannot write to {directory}: {why}; give --out a directory that can be created or written to."
        )


@contextmanager
def locked(directory: Path) -> Iterator[None]:
    """Keep other runs out of a directory; the lock ends with the process.

    Raises:
        UsageError: another run holds it.
    """
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with suppress(OSError):  # a file system without locks
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise UsageError(
                    f"Another multilica run is writing to {directory}; wait for its end, or give --out another one."
                ) from None
        yield
    finally:
        os.close(descriptor)


def place_for_run(directory: Path) -> Path:
    """Return where a run into a locked directory writes, and finish what a killed run was doing there."""
    if (directory / UNFINISHED / _WHOLE).exists():
        with suppress(DocumentError):  # not a list that a run wrote
            publish(directory)
    if (directory / UNFINISHED).exists():
        shutil.rmtree(directory / UNFINISHED)
    return directory / UNFINISHED if _holds_result(directory) else directory


def publish(directory: Path) -> None:
    """Replace the earlier run by the one in `unfinished`, which is whole.

    Renames take no time and no space. A list of the entries is written before, so that the next run can finish what
    a kill interrupts.
    """
    unfinished = directory / UNFINISHED
    listed = unfinished / _WHOLE
    if not listed.exists():
        write_text_atomically(listed, json.dumps(sorted(path.name for path in unfinished.iterdir())))
    whole = parse_json(listed.read_bytes())
    # A list that came with the directory may hold anything; only entries of `unfinished` are moved.
    present = {path.name for path in unfinished.iterdir()}
    names = [name for name in whole if isinstance(name, str)] if isinstance(whole, list) else []
    _remove_snapshots(directory, keep=names)
    for path in outputs(directory):
        if path.name not in names:
            path.unlink(missing_ok=True)
    for name in sorted(present.intersection(names)):
        if (unfinished / name).is_dir() and (directory / name).is_dir():
            shutil.rmtree(directory / name)
        (unfinished / name).replace(directory / name)
    shutil.rmtree(unfinished)


def _remove_snapshots(directory: Path, keep: Sequence[str] = ()) -> None:
    """Remove the directories of the single snapshots that the result of an earlier run names, but those to keep."""
    earlier = (_result(directory) or {}).get("snapshots")
    for each in earlier if isinstance(earlier, list) else []:
        name = each.get("name") if isinstance(each, dict) else None
        if not isinstance(name, str) or name in keep or Path(name).name != name or name in ("", ".."):
            continue
        place = directory / name
        if (place / CONFIG_TOML).is_file() and not place.is_symlink() and not _is_foreign(place / CONFIG_TOML):
            shutil.rmtree(place)


def _is_foreign(config: Path) -> bool:
    return config.exists() and not config.read_bytes().startswith(CONFIG_HEADER.encode())


def _is_unfinished_run(unfinished: Path) -> bool:
    if not unfinished.is_dir():
        return False
    whole, config = unfinished / _WHOLE, unfinished / CONFIG_TOML
    begun = not any(unfinished.iterdir()) or bool(begun_files(config))
    return begun or whole.exists() or (config.exists() and not _is_foreign(config))


def _holds_result(directory: Path) -> bool:
    """Return whether an earlier run left a result that is not a refusal."""
    found = _result(directory)
    return found is not None and found.get("refusal") is None


def _result(directory: Path) -> dict[str, object] | None:
    """Return the result that an earlier run left; None if there is none that can be read."""
    try:
        document = parse_json(read_limited(directory / RESULT_JSON, MAX_JSON_BYTES))
    except (OSError, DocumentError):
        return None
    return document if isinstance(document, dict) else None


@dataclass(slots=True, eq=False)
class RunDirectory:
    """An observer that passes each event to every sink.

    Args:
        directory: of the whole run.
        place: where the sinks write: the directory itself, or `unfinished` in it while it holds an earlier result.
        config: written as `config.toml` before the first event.
        sinks: called in this order.
        started: whether anything of this run is on disk.
        has_result: whether the calibration finished and the snapshot was not refused.
    """

    directory: Path
    place: Path
    config: CalibrationConfig
    sinks: Sequence[Observer]
    started: bool = False
    has_result: bool = False

    def __call__(self, event: events.Event) -> None:
        """Pass the event to every sink."""
        if not self.started:
            self.start()
        if isinstance(event, events.CalibrationFinished):
            self.has_result = event.result.refusal is None
        for sink in self.sinks:
            sink(event)

    def start(self) -> None:
        """Remove what an unfinished run left, and write the configuration."""
        _remove_snapshots(self.place)
        for path in outputs(self.place):
            for left in (path, *begun_files(path)):
                left.unlink(missing_ok=True)
        self.place.mkdir(exist_ok=True)
        write_text_atomically(self.place / CONFIG_TOML, CONFIG_HEADER + config_toml(self.config))
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
