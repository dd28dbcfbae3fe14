# SPDX-License-Identifier: Apache-2.0
"""CPU time of the whole process against the simplest peer, KISS-Matcher with small_gicp, and against preset `paper`."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.bench.support.claims import Claim, at_most, print_claims, print_table
from tests.bench.support.process_cost import cost_of
from tests.bench.support.recordings import ONE_WORKER, SAMPLE, calibration_cost, record, target_of

PEER = "tests.bench.support.kiss_baseline"
SCENES = ("street", "parking", "garage", "open_field")
_REPEATS = 5
_LIMIT, _LIMIT_BY_PAPER = 1.0, 0.5


@dataclass(frozen=True, slots=True)
class Lap:
    """CPU seconds of all on one recording, one after the other, so that what else the machine does meets each."""

    ours_s: float
    peer_s: float
    paper_s: float


def main() -> bool:
    """Print the times, and whether the ratios hold."""
    with tempfile.TemporaryDirectory() as folder:
        recordings = {"sample": SAMPLE} | {f"edgar {scene}": record(Path(folder), "edgar", scene) for scene in SCENES}
        laps = {name: _laps(path) for name, path in recordings.items()}
    print_table(
        ("recording", "repeat", "multilica s", "peer s", "paper s"),
        [
            (name, repeat, f"{lap.ours_s:.2f}", f"{lap.peer_s:.2f}", f"{lap.paper_s:.2f}")
            for name, of_recording in laps.items()
            for repeat, lap in enumerate(of_recording)
        ],
    )
    return print_claims([each for name, of_recording in laps.items() for each in claims(name, of_recording)])


def claims(name: str, laps: Sequence[Lap]) -> list[Claim]:
    """Judge the median ratios."""
    return [
        at_most(f"CPU of {name} against the peer", [lap.ours_s / lap.peer_s for lap in laps], _LIMIT, "x"),
        at_most(f"CPU of {name} against `paper`", [lap.ours_s / lap.paper_s for lap in laps], _LIMIT_BY_PAPER, "x"),
    ]


def _laps(recording: Path) -> list[Lap]:
    target = target_of(recording)
    return [_lap(recording, target) for _ in range(_REPEATS)]


def _lap(recording: Path, target: str) -> Lap:
    """All on one core, as the peer's pool of threads takes all cores that it finds."""
    ours = calibration_cost(recording, *ONE_WORKER, cores=1)
    peer = cost_of(PEER, recording, target, cores=1)
    paper = calibration_cost(recording, "--preset", "paper", *ONE_WORKER, cores=1)
    return Lap(ours.cpu_s, peer.cpu_s, paper.cpu_s)
