# SPDX-License-Identifier: Apache-2.0
"""Thousands of damaged files for each reader and document: a value or one sentence, each within 1 GB and 10 s."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

from multilica.errors import MultilicaError
from tests.ingest.support.documents import Document, documents
from tests.ingest.support.mutations import SEEDS, mutated, read_or_refuse, write_seed
from tests.ingest.support.structured import structured

CASES = int(os.environ.get("MULTILICA_MUTATIONS", "20000"))
MEMORY_BYTES = 1_000_000_000
"""On top of what the imports take."""
LIMIT_S = 10
READ, REFUSED, FAILED = 0, 3, 1
SLOW = {"a.laz": 10, "b.laz": 10, "packed.db3.zstd": 4, "ouster.mcap": 4}
"""Readers that start a process or unpack a file to disk, and files that are large: so many times fewer cases."""


def main() -> bool:
    """Print a line per reader, and whether all held."""
    print(f"{CASES} cases per reader, each a process of at most {MEMORY_BYTES // 10**6} MB more and {LIMIT_S} s\n")
    print("| reader | read | refused | slowest s | outcome |")
    print("|---|---|---|---|---|")
    good = True
    for name in [*SEEDS, *documents()]:
        command = [sys.executable, "-m", "tests.bench.fuzz", name, str(max(1, CASES // SLOW.get(name, 1)))]
        ended = subprocess.run(command, capture_output=True, text=True, check=False)
        row = ended.stdout.strip() or f"| {name} | | | | died with {ended.returncode}: {ended.stderr.strip()[-200:]} |"
        good &= row.endswith("| good |")
        print(row, flush=True)
    return good


def fuzz(name: str, cases: int, first: int = 0) -> str:
    """A row of the table; seeds of what failed stand in it."""
    outcomes: Counter[int] = Counter()
    failures: list[str] = []
    slowest_s = 0.0
    with tempfile.TemporaryDirectory() as folder:
        path, content, read = _subject(name, Path(folder))
        path.write_bytes(content)
        read(path)
        for seed in range(first, first + cases):
            generator = np.random.default_rng(seed)
            path.write_bytes((structured if seed % 2 else mutated)(content, generator))
            start_s = time.perf_counter()
            code, text = _confined(read, path)
            slowest_s = max(slowest_s, time.perf_counter() - start_s)
            outcomes[code] += 1
            if code not in (READ, REFUSED):
                failures.append(f"seed {seed}: {text}"[:300])
    outcome = f"{len(failures)} FAILED: {failures[:5]}" if failures else "good"
    return f"| {name} | {outcomes[READ]} | {outcomes[REFUSED]} | {slowest_s:.2f} | {outcome} |"


def _subject(name: str, folder: Path) -> tuple[Path, bytes, Callable[[Path], object]]:
    if name in SEEDS:
        path = write_seed(name, folder)
        return path, path.read_bytes(), lambda each: read_or_refuse(each, inspect=True)
    document: Document = documents()[name]
    return folder / name, document.content, document.read


def _confined(read: Callable[[Path], object], path: Path) -> tuple[int, str]:
    """Read a file in a process of its own; return its exit code, or its signal as a negative number, and its words."""
    receiver, sender = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(receiver)
        code, text = FAILED, ""
        try:
            code, text = _read_limited(read, path)
        finally:
            os.write(sender, text.encode("utf-8", "replace")[:4000])
            os._exit(code)
    os.close(sender)
    with os.fdopen(receiver, "rb") as pipe:
        text = pipe.read().decode("utf-8", "replace")
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    return code, text or f"ended with {code}"


def _read_limited(read: Callable[[Path], object], path: Path) -> tuple[int, str]:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    most = pages * resource.getpagesize() + MEMORY_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(LIMIT_S)
    warnings.simplefilter("error")
    try:
        return (REFUSED if read(path) is None else READ), ""
    except MultilicaError as error:
        text = str(error)
        return (REFUSED, "") if len(text) <= 500 and text.isprintable() else (FAILED, f"not one sentence: {text}")
    except BaseException as error:  # noqa: BLE001 - anything at all is a finding
        place = traceback.extract_tb(error.__traceback__)[-1]
        return FAILED, f"{type(error).__name__} {error} at {Path(place.filename).name}:{place.lineno}"


if __name__ == "__main__":
    print(fuzz(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) > 3 else 0))
