# SPDX-License-Identifier: Apache-2.0
"""Run the measurements named on the command line, or all of them."""

from __future__ import annotations

import sys
from importlib import import_module

MEASUREMENTS = ("accuracy",)


def main(names: list[str]) -> int:
    """Print each measurement under its name."""
    unknown = [name for name in names if name not in MEASUREMENTS]
    if unknown:
        print(f"There is no measurement '{unknown[0]}'; available: {', '.join(MEASUREMENTS)}.", file=sys.stderr)
        return 2
    for name in names or MEASUREMENTS:
        print(f"## {name}\n", flush=True)
        import_module(f"tests.bench.{name}").main()
        print(flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
