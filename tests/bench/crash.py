# SPDX-License-Identifier: Apache-2.0
"""What is left of runs that are killed at random moments."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mcap.reader import make_reader

from multilica.config import STAGES
from multilica.errors import MultilicaError
from multilica.runs.run_documents import explain_run, read_run_document
from tests.bench.support.claims import Claim, print_claims, print_table

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = ROOT / "recordings" / "samples" / "edgar-street.mcap"
MOMENTS = 20
SEED = 4
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
_RECORDINGS = ("recording.rrd", "recording.partial.rrd")
_MCAPS = ("result.mcap", "result.partial.mcap")
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


def main() -> bool:
    """Print the table; whether every run left what it had told. A run without a signal comes first, for its length."""
    # Ignored, as shells have it for what they start in the background, it would stay so in the runs.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with tempfile.TemporaryDirectory() as folder:
        length_s = _run(Path(folder) / "whole", None, 0.0)[1]
        draw = random.Random(SEED)  # noqa: S311
        moments = sorted(draw.uniform(0.0, length_s) for _ in range(MOMENTS))
        rows, faults = [], 0
        for index, moment_s in enumerate(moments):
            number = SIGNALS[index % len(SIGNALS)]
            remains, _ = _run(Path(folder) / str(index), number, moment_s)
            cells = (remains.told, remains.in_recording, remains.in_mcap, remains.headline, remains.fault)
            rows.append((f"{moment_s:.1f}", number.name, *(cell or "-" for cell in cells)))
            faults += bool(remains.fault)
    print_table(("at s", "signal", "last stage told", "in .rrd", "in .mcap", "explain", "fault"), rows)
    measure = (
        f"runs that left every stage they had told, in .rrd and .mcap, of {MOMENTS} stopped within {length_s:.0f} s"
    )
    return print_claims([Claim(measure, str(MOMENTS), str(MOMENTS - faults), faults == 0)])


def _run(out: Path, number: signal.Signals | None, moment_s: float) -> tuple[Remains, float]:
    """What is left of a run that gets that signal so many seconds after it has read its input, and how long it ran."""
    command = [sys.executable, "-m", "multilica_cli", "calibrate", str(SAMPLE), "--out", str(out), *_OPTIONS]
    path = os.pathsep.join((str(ROOT), str(ROOT / "cli")))
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        if process.stderr is None or not process.stderr.readline().startswith("ingest"):
            raise RuntimeError(f"{command} did not read its input")
        start_s = time.monotonic()
        if number is not None:
            time.sleep(moment_s)
            process.send_signal(number)
        _, spoken = process.communicate()
        length_s = time.monotonic() - start_s
    words = [line.split()[0] for line in spoken.splitlines() if line.strip()]
    told = [word for word in words if word in STAGES]
    return _remains(out, told[-1] if told else "", killed=number == signal.SIGKILL), length_s


def _remains(out: Path, told: str, *, killed: bool) -> Remains:
    """What is there; a killed process cannot remove the hidden file that it was writing, the next run does."""
    if not out.exists() or not list(out.iterdir()):
        return Remains(told, "", "", "nothing was written", "a finished stage is lost" if told else "")
    faults = [f"{path.name} is half written" for path in out.iterdir() if path.suffix == ".tmp" and not killed]
    try:
        headline = explain_run(out).headline
    except MultilicaError as error:
        return Remains(told, "", "", str(error), "; ".join([*faults, *(["cannot be explained"] if told else [])]))
    held = [_last_stage(out, names, told, faults) for names in (_RECORDINGS, _MCAPS)]
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
        explain_run(file)
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
