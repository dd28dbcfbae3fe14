# SPDX-License-Identifier: Apache-2.0
"""CPU time of what happens before the first stage."""

from __future__ import annotations

from tests.bench.support.claims import at_most, print_claims
from tests.bench.support.process_cost import cost_of
from tests.bench.support.recordings import SAMPLE, calibration_cost

_REPEATS = 7


def main() -> bool:
    """Print whether the times are short."""
    texts, readings = [], []
    for _ in range(_REPEATS):
        texts.append(cost_of("multilica_cli", "--help").cpu_s)
        readings.append(calibration_cost(SAMPLE, "--until", "ingest").cpu_s)
    return print_claims(
        [
            at_most("CPU of --help", texts, 0.25, "s"),
            at_most("CPU of calibrate --until ingest of the sample", readings, 1.5, "s"),
        ]
    )
