# SPDX-License-Identifier: Apache-2.0
"""What a run's files cost on the demo."""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from multilica.config import CalibrationConfig, with_overrides
from multilica.events import Event
from multilica.ingest import read_snapshot
from multilica.pipeline import calibrate
from multilica.sinks.run_directory import open_run
from multilica.snapshot import Snapshot
from tests.bench.support.claims import Claim, print_claims, print_table

SAMPLE = Path(__file__).resolve().parents[2] / "recordings" / "samples" / "edgar-street.mcap"
_DETAILS = ("full", "normal", "slim")
_ROUNDS = 5
_LIMIT = 0.15


@dataclass(frozen=True, slots=True)
class Turn:
    """The demo once.

    Args:
        bare_s: what its calibration took of the processor.
        recorded_s: what the run took in all: the same with the files, the recording's own threads included. Both are
            taken from one run, for what else the machine does costs two runs differently.
        rrd_mb: size of the recording.
    """

    bare_s: float
    recorded_s: float
    rrd_mb: float


def main() -> bool:
    """Print the times, and whether the cost is small."""
    config = CalibrationConfig()
    snapshot = read_snapshot([SAMPLE], config=config.ingest)
    turns: dict[str, list[Turn]] = {detail: [] for detail in _DETAILS}
    helpers_s = _helpers_s(snapshot, config)
    for each in range(_ROUNDS):
        for detail, taken in turns.items():
            taken.append(_turn(snapshot, with_overrides(config, [f"record.detail={detail}"]), helpers_s))
            print(f"{detail}, round {each}: {taken[-1].recorded_s:.1f} s", file=sys.stderr, flush=True)
    print_table(
        ("record.detail", "round", "without files, processor s", "with", "recording.rrd MB"),
        [
            (detail, each, f"{turn.bare_s:.2f}", f"{turn.recorded_s:.2f}", f"{turn.rrd_mb:.1f}")
            for detail, taken in turns.items()
            for each, turn in enumerate(taken)
        ],
    )
    return print_claims([claim(detail, taken) for detail, taken in turns.items()])


def claim(detail: str, turns: Sequence[Turn]) -> Claim:
    """The median over the turns."""
    more = float(np.median([turn.recorded_s / turn.bare_s for turn in turns])) - 1.0
    return Claim(f"cost of a run's files, {detail}", f"< {_LIMIT:.0%} of the run", f"{more:.1%}", more < _LIMIT)


def _helpers_s(snapshot: Snapshot, config: CalibrationConfig) -> float:
    """What threads that libraries start for the calibration itself take of the processor."""
    start_s, main_start_s = time.process_time(), time.thread_time()
    calibrate(snapshot, config)
    return (time.process_time() - start_s) - (time.thread_time() - main_start_s)


def _turn(snapshot: Snapshot, config: CalibrationConfig, helpers_s: float) -> Turn:
    files_s = 0.0
    with tempfile.TemporaryDirectory() as directory:
        start_s, main_start_s = time.process_time(), time.thread_time()
        with open_run(Path(directory), config) as run:

            def observe(event: Event) -> None:
                nonlocal files_s
                told_s = time.thread_time()
                run(event)
                files_s += time.thread_time() - told_s

            calibrate(snapshot, config, observe)
            end_s = time.thread_time()
        files_s += time.thread_time() - end_s
        bare_s = time.thread_time() - main_start_s - files_s + helpers_s
        recorded_s = time.process_time() - start_s
        rrd_mb = (Path(directory) / "recording.rrd").stat().st_size / 1e6
    return Turn(bare_s, recorded_s, rrd_mb)
