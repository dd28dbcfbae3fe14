# SPDX-License-Identifier: Apache-2.0
"""Servers of the tests, each in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[3]


@contextmanager
def served(script: str, *arguments: object) -> Iterator[int]:
    """The port that a script of this folder prints as its first line; it ends with the block."""
    command = [sys.executable, str(Path(__file__).parent / script), *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment) as process:
        try:
            yield int(process.stdout.readline().split()[-1])
        finally:
            process.kill()
