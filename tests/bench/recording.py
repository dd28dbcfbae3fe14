# SPDX-License-Identifier: Apache-2.0
"""What a run's files cost: the demo with and without them, in turns."""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from multilica.config import CalibrationConfig, with_overrides
from multilica.ingest import read_snapshot
from multilica.pipeline import calibrate
from multilica.sinks.run_directory import open_run
from multilica.snapshot import Snapshot
from tests.bench.claims import Claim, print_claims, print_table

__all__ = ["Turn", "claim", "main"]

SAMPLE = Path(__file__).resolve().parents[2] / "recordings" / "samples" / "edgar-street.mcap"
_DETAILS = ("full", "normal", "slim")
_ROUNDS = 3
_LIMIT = 0.15


@dataclass(frozen=True, slots=True)
class Turn:
    """The demo once without files, then with them.

    Args:
        bare_s, recorded_s: what it took of the processor, the recording's own threads included; wall time would tell
            what else the machine does.
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
    for each in range(_ROUNDS):
        for detail, taken in turns.items():
            taken.append(_turn(snapshot, with_overrides(config, [f"record.detail={detail}"])))
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
    """The ratio of the medians."""
    bare_s, recorded_s = (
        float(np.median([getattr(turn, side) for turn in turns])) for side in ("bare_s", "recorded_s")
    )
    more = recorded_s / bare_s - 1.0
    return Claim(f"cost of a run's files, {detail}", f"< {_LIMIT:.0%} of the run", f"{more:.1%}", more < _LIMIT)


def _turn(snapshot: Snapshot, config: CalibrationConfig) -> Turn:
    start_s = time.process_time()
    calibrate(snapshot, config)
    bare_s = time.process_time() - start_s
    with tempfile.TemporaryDirectory() as directory:
        start_s = time.process_time()
        with open_run(Path(directory), config) as observe:
            calibrate(snapshot, config, observe)
        recorded_s = time.process_time() - start_s
        rrd_mb = (Path(directory) / "recording.rrd").stat().st_size / 1e6
    return Turn(bare_s, recorded_s, rrd_mb)
