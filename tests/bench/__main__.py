# SPDX-License-Identifier: Apache-2.0
"""Run the measurements named on the command line, or all that make claims."""

from __future__ import annotations

import os
import sys
from importlib import import_module

MEASUREMENTS = (
    "real_scans",
    "simulated",
    "certainty",
    "large_rigs",
    "blind",
    "speed",
    "startup",
    "scaling",
    "longest",
    "repeat",
    "harder",
    "hard",
    "causes",
    "moved_lidars",
    "knocks",
    "fleet_drift",
    "fleet_year",
    "crash",
    "ingest",
    "recording",
)
ON_REQUEST = ("paper", "peers", "tables", "fuzz", "soak", "evidence", "fleet_scale", "drives", "random_rigs")
ROBUSTNESS = ("crash", "fuzz", "hard", "longest", "random_rigs", "soak")
FLEET = ("fleet_drift", "fleet_scale", "fleet_year", "knocks")


def main(names: list[str]) -> int:
    """Print each measurement under its name; 1 if a claim does not hold."""
    available = (*MEASUREMENTS, *ON_REQUEST)
    unknown = [name for name in names if name not in available]
    if unknown:
        print(f"There is no measurement '{unknown[0]}'; available: {', '.join(available)}.", file=sys.stderr)
        return 2
    holds = True
    for name in names or MEASUREMENTS:
        print(f"## {name}\n", flush=True)
        holds &= import_module(module_of(name)).main()
    return 0 if holds else 1


def module_of(name: str) -> str:
    """The module of a measurement."""
    if name in FLEET:
        return f"tests.bench.fleet.{name}"
    if name == "drives":
        return "tests.bench.drives.drives"
    return f"tests.bench.robustness.{name}" if name in ROBUSTNESS else f"tests.bench.{name}"


def one_thread_each() -> None:
    """Keep the pools of libraries that are yet to be loaded, here or in a process of ours, to one thread."""
    for pool in ("OMP", "OPENBLAS", "MKL"):
        os.environ[f"{pool}_NUM_THREADS"] = "1"


if __name__ == "__main__":
    one_thread_each()
    sys.exit(main(sys.argv[1:]))
