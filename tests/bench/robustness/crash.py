# SPDX-License-Identifier: Apache-2.0
"""What is left of `calibrate`, `record` and `report` when they are killed at random moments."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from mcap.reader import make_reader

from multilica.config import STAGES
from multilica.diagnosis import explain
from multilica.errors import MultilicaError
from multilica.ingest import read_snapshot
from multilica.runs.run_documents import read_run_document
from tests.bench.support.claims import Claim, print_claims, print_table
from tests.ingest.support.processes import served

ROOT = Path(__file__).resolve().parents[3]
SAMPLE = ROOT / "recordings" / "samples" / "edgar-street.mcap"
KILLS = int(os.environ.get("MULTILICA_KILLS", "20"))
FRAMES = 30
WRITE_S = 0.01
_UNFINISHED = ".tmp"
SEED = 4
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
_RECORDINGS = ("recording.rrd", "recording.partial.rrd")
_MCAPS = ("result.mcap", "result.partial.mcap")
_LAST_LONG = "fine"
_OPTIONS = ("--frames", "1", "--topic", "left=/lidar/left/points", "--topic", "right=/lidar/right/points")


@dataclass(frozen=True, slots=True)
class Remains:
    """What a run left.

    Args:
        told: the last stage that the terminal said was finished; "" if none.
        in_recording, in_mcap: the last stage that this file alone knows of; "" if there is none.
        headline: what `explain` says first.
        fault: what should not be; "" if all is well.
    """

    told: str
    in_recording: str
    in_mcap: str
    headline: str
    fault: str


@dataclass(frozen=True, slots=True)
class Rewriting:
    """A command that replaces one file in a directory with others.

    Args:
        is_whole: whether the file is one that the command finished.
    """

    name: str
    arguments: tuple[object, ...]
    file: Path
    is_whole: Callable[[Path], bool]


def main() -> bool:
    """Print the table; whether every run left what it should."""
    # Ignored, as shells have it for what they start in the background, it would stay so in the runs.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with tempfile.TemporaryDirectory() as folder:
        claims = [_calibrations(Path(folder) / "calibrate"), _records(Path(folder)), _reports(Path(folder) / "run")]
    return print_claims(claims)


def _calibrations(folder: Path) -> Claim:
    """A run without a signal comes first, for its length."""
    length_s = _run(folder / "whole", None, 0.0)[1]
    draw = random.Random(SEED)  # noqa: S311
    moments = sorted(draw.uniform(0.0, length_s) for _ in range(KILLS))
    rows, faults = [], 0
    for index, moment_s in enumerate(moments):
        number = SIGNALS[index % len(SIGNALS)]
        remains, _ = _run(folder / str(index), number, moment_s)
        cells = (remains.told, remains.in_recording, remains.in_mcap, remains.headline, remains.fault)
        rows.append((f"{moment_s:.1f}", number.name, *(cell or "-" for cell in cells)))
        faults += bool(remains.fault)
    print_table(("at s", "signal", "last stage told", "in .rrd", "in .mcap", "explain", "fault"), rows)
    stopped = f"of {KILLS} stopped within {length_s:.0f} s"
    measure = f"runs that left every stage they had told, in .mcap up to {_LAST_LONG}, {stopped}"
    return Claim(measure, str(KILLS), str(KILLS - faults), faults == 0)


def _records(folder: Path) -> Claim:
    file = folder / "record" / "vehicle.mcap"
    with served("bridge_server.py", "cdr", 0, "") as port:
        arguments = ("record", f"ws://127.0.0.1:{port}", "--out", file, "--frames", FRAMES, "--quiet")
        return _rewritings(Rewriting("record", arguments, file, _is_whole_snapshot))


def _is_whole_snapshot(file: Path) -> bool:
    return [len(lidar.scans) for lidar in read_snapshot(file).lidars] == [FRAMES, FRAMES]


def _reports(run: Path) -> Claim:
    subprocess.run(_command("calibrate", SAMPLE, "--out", run, *_OPTIONS, "--quiet"), env=_environment(), check=True)
    file = run / "report.html"
    of_run, arguments = file.read_bytes(), ("report", run, "--out", file, "--quiet")
    subprocess.run(_command(*arguments), env=_environment(), check=True)
    again = file.read_bytes()
    file.write_bytes(of_run + b"<!-- of the run itself -->")
    return _rewritings(Rewriting("report", arguments, file, lambda left: left.read_bytes() == again))


def _rewritings(of: Rewriting) -> Claim:
    """Kill the command at any moment, and every other time just after it has begun to write."""
    folder = of.file.parent
    temporary = Path(tempfile.mkdtemp(dir=folder.parent))
    environment = {**_environment(), "TMPDIR": str(temporary)}
    old = of.file.read_bytes() if of.file.exists() else b""
    start_s = time.monotonic()
    subprocess.run(_command(*of.arguments), env=environment, check=True)
    length_s = time.monotonic() - start_s
    old = old or of.file.read_bytes()
    draw = random.Random(SEED)  # noqa: S311
    ended, replaced, begun, faults = 0, 0, 0, []
    for index in range(KILLS):
        of.file.write_bytes(old)
        before = _contents(folder)
        with subprocess.Popen(_command(*of.arguments), env=environment) as process:
            _wait_for_moment(process, folder, draw, length_s, at_writing=index % 2 == 1)
            process.kill()
        ended += process.returncode == 0
        after = _contents(folder)
        is_new = after[of.file.name] != before[of.file.name]
        left = {name for name in after if name.endswith(_UNFINISHED)}
        begun += bool(left - before.keys())
        replaced += is_new
        if is_new or left - before.keys():
            faults += [f"{name} of an earlier run is left" for name in left & before.keys()]
        others = [name for name in before if name != of.file.name and not name.endswith(_UNFINISHED)]
        faults += [f"{name} has changed" for name in others if after.get(name) != before[name]]
        with suppress(MultilicaError):
            if not is_new or of.is_whole(of.file):
                continue
        faults.append(f"{of.file.name} is neither the old one nor whole")
    subprocess.run(_command(*of.arguments), env=environment, check=True)
    faults += [f"{path.name} is left in TMPDIR" for path in temporary.iterdir()]
    faults += [
        f"{name} is left after a run that was not killed" for name in _contents(folder) if name.endswith(_UNFINISHED)
    ]
    rows = [(of.name, KILLS - ended, f"{length_s:.1f}", begun, replaced, "; ".join(faults) or "-")]
    print_table(("command", "killed", "length s", "left a temporary file", "left a new file", "faults"), rows)
    measure = (
        f"{of.name}: the old file or the whole new one, all others as before, no temporary file after the next run"
    )
    return Claim(f"{measure}, of {KILLS}", "0 faults", f"{len(faults)} faults", not faults)


def _wait_for_moment(
    process: subprocess.Popen[bytes], folder: Path, draw: random.Random, length_s: float, *, at_writing: bool
) -> None:
    if not at_writing:
        time.sleep(draw.uniform(0.0, length_s))
        return
    before = set(folder.iterdir())
    while process.poll() is None and not any(path.suffix == _UNFINISHED for path in set(folder.iterdir()) - before):
        time.sleep(0.0005)
    time.sleep(draw.uniform(0.0, WRITE_S))


def _contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def _command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "multilica_cli", *map(str, arguments)]


def _environment() -> dict[str, str]:
    path = os.pathsep.join((str(ROOT), str(ROOT / "cli")))
    return {**os.environ, "PYTHONPATH": path, "PYTHONUNBUFFERED": "1"}


def _run(out: Path, number: signal.Signals | None, moment_s: float) -> tuple[Remains, float]:
    """What is left of a run that gets that signal so many seconds after it has read its input, and how long it ran."""
    command = _command("calibrate", SAMPLE, "--out", out, *_OPTIONS)
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=_environment()
    ) as process:
        if process.stderr is None or not process.stderr.readline().startswith("ingest"):
            raise RuntimeError(f"{command} did not read its input")
        start_s = time.monotonic()
        if number is not None:
            time.sleep(moment_s)
            process.send_signal(number)
        _, spoken = process.communicate()
        length_s = time.monotonic() - start_s
    if number is None and process.returncode != 0:
        raise RuntimeError(f"{command} ended with {process.returncode}: {spoken}")
    words = [line.split()[0] for line in spoken.splitlines() if line.strip()]
    told = [word for word in words if word in STAGES]
    return _remains(out, told[-1] if told else "", killed=number == signal.SIGKILL), length_s


def _remains(out: Path, told: str, *, killed: bool) -> Remains:
    """What is there; a killed process cannot remove the hidden file that it was writing, the next run does."""
    if not out.exists() or not list(out.iterdir()):
        return Remains(told, "", "", "nothing was written", "a finished stage is lost" if told else "")
    faults = [f"{path.name} is half written" for path in out.iterdir() if path.suffix == _UNFINISHED and not killed]
    try:
        headline = explain(read_run_document(out).document).headline
    except MultilicaError as error:
        return Remains(told, "", "", str(error), "; ".join([*faults, *(["cannot be explained"] if told else [])]))
    # Later stages take milliseconds; the unfinished MCAP file is not written for them.
    long = told if told not in STAGES or STAGES.index(told) < STAGES.index(_LAST_LONG) else _LAST_LONG
    held = [_last_stage(out, names, of, faults) for names, of in ((_RECORDINGS, told), (_MCAPS, long))]
    mcap = next((out / name for name in _MCAPS if (out / name).exists()), None)
    if mcap is not None and not _readable(mcap):
        faults.append(f"{mcap.name} cannot be read")
    return Remains(told, *held, headline, "; ".join(faults))


def _last_stage(out: Path, names: Sequence[str], told: str, faults: list[str]) -> str:
    """The last stage that this file alone knows of; what is amiss goes to `faults`."""
    file = next((out / name for name in names if (out / name).exists()), None)
    if file is None:
        faults += [f"{names[0]} is missing"] if told else []
        return ""
    try:
        explain(read_run_document(file).document)
        finished = read_run_document(file).document.progress.finished
    except MultilicaError as error:
        faults += [str(error)] if told else []
        return ""
    faults += [f"{file.name} has lost a finished stage"] if told and told not in finished else []
    return str(finished[-1]) if finished else ""


def _readable(mcap: Path) -> bool:
    with mcap.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        return bool(sum(1 for _ in reader.iter_messages())) and bool(list(reader.iter_attachments()))
