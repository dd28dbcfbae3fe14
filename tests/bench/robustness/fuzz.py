# SPDX-License-Identifier: Apache-2.0
"""Thousands of damaged files for each reader and document: a value or one sentence, each within 1 GB and 10 s.

A process reads many of them, each with its own time limit and all within the memory limit; one that ends it is counted
and told, and another process goes on behind it.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import zstandard

from multilica.errors import MultilicaError
from tests.ingest.support.documents import documents
from tests.ingest.support.mutations import SEEDS, mutated, read_or_refuse, write_seed
from tests.ingest.support.structured import structured

CASES = int(os.environ.get("MULTILICA_MUTATIONS", "20000"))
MEMORY_BYTES = 1_000_000_000
"""On top of what the imports take; of a process that a reader starts, all that it has in memory."""
LIMIT_S = 10
BATCH = 500
READ, REFUSED, FAILED = "read", "refused", "failed"
SLOW = {"a.laz": 10, "b.laz": 10, "result.rrd": 10, "result.mcap": 10, "ouster.mcap": 4}
"""Readers that start a process, and files that are large: so many times fewer cases."""
_PACKED = ".zst"


@dataclass
class Row:
    """A row of the table."""

    name: str
    read: int = 0
    refused: int = 0
    slowest_s: float = 0.0
    failures: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        outcome = f"{len(self.failures)} FAILED: {self.failures[:5]}" if self.failures else "good"
        return f"| {self.name} | {self.read} | {self.refused} | {self.slowest_s:.2f} | {outcome} |"


def main() -> bool:
    """Print a line per reader, and whether all held."""
    print(f"{CASES} cases per reader, each of at most {MEMORY_BYTES // 10**6} MB more and {LIMIT_S} s\n")
    print("| reader | read | refused | slowest s | outcome |")
    print("|---|---|---|---|---|")
    good = True
    for name in [*SEEDS, *documents()]:
        command = [sys.executable, "-m", __name__, name, str(max(1, CASES // SLOW.get(name, 1)))]
        ended = subprocess.run(command, capture_output=True, text=True, check=False)
        row = ended.stdout.strip() or f"| {name} | | | | died with {ended.returncode}: {ended.stderr.strip()[-200:]} |"
        good &= row.endswith("| good |")
        print(row, flush=True)
    return good


def fuzz(name: str, cases: int, first: int = 0) -> Row:
    """A row of the table; seeds of what failed stand in it."""
    row = Row(name)
    with tempfile.TemporaryDirectory() as folder:
        path, content, read = _subject(name, Path(folder))
        path.write_bytes(content)
        read(path)
        seed, end = first, first + cases
        while seed < end:
            for outcome, taken_s, text in _confined(path, content, read, range(seed, min(end, seed + BATCH))):
                row.slowest_s = max(row.slowest_s, taken_s)
                row.read += outcome == READ
                row.refused += outcome == REFUSED
                row.failures += [f"seed {seed}: {text}"[:300]] if outcome == FAILED else []
                seed += 1
    return row


def _subject(name: str, folder: Path) -> tuple[Path, bytes, Callable[[Path], object]]:
    if name in SEEDS:
        path = write_seed(name, folder)
        return path, path.read_bytes(), lambda each: read_or_refuse(each, inspect=True)
    document = documents()[name]
    return folder / name, document.content, document.read


def _changed(name: str, content: bytes, seed: int) -> bytes:
    """Half of what is packed is changed before it is packed: otherwise little would reach the reader of its content."""
    generator = np.random.default_rng(seed)
    change = structured if seed % 2 else mutated
    if _PACKED in name and seed % 4 > 1:
        return zstandard.compress(change(_unpacked(content), generator))
    return change(content, generator)


def _unpacked(content: bytes) -> bytes:
    return zstandard.ZstdDecompressor().decompressobj().decompress(content)


def _confined(
    path: Path, content: bytes, read: Callable[[Path], object], seeds: range
) -> Iterator[tuple[str, float, str]]:
    """Yield outcome, seconds and words of files that a process of their own reads, up to one that ends the process."""
    receiver, sender = os.pipe()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            os.close(receiver)
            _read_all(path, content, read, seeds, sender)
            code = 0
        finally:
            os._exit(code)
    os.close(sender)
    with os.fdopen(receiver, encoding="utf-8") as pipe:
        yield from map(json.loads, pipe)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code:
        yield FAILED, LIMIT_S, f"ended with {code}"


def _read_all(path: Path, content: bytes, read: Callable[[Path], object], seeds: range, sender: int) -> None:
    _limit_memory()
    with os.fdopen(sender, "w", encoding="utf-8", errors="replace") as pipe:
        for seed in seeds:
            path.write_bytes(_changed(path.name, content, seed))
            start_s = time.perf_counter()
            outcome, text = _outcome(read, path)
            print(json.dumps((outcome, time.perf_counter() - start_s, text[:400])), file=pipe, flush=True)


def _limit_memory() -> None:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    most = pages * resource.getpagesize() + MEMORY_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, resource.RLIM_INFINITY))
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    warnings.simplefilter("error")


def _outcome(read: Callable[[Path], object], path: Path) -> tuple[str, str]:
    signal.alarm(LIMIT_S)
    try:
        outcome, text = (REFUSED if read(path) is None else READ), ""
    except MultilicaError as error:
        outcome, text = REFUSED, str(error)
        if len(text) > 500 or not text.isprintable():
            return FAILED, f"not one sentence: {text}"
    except BaseException as error:  # noqa: BLE001 - anything at all is a finding
        place = traceback.extract_tb(error.__traceback__)[-1]
        return FAILED, f"{type(error).__name__} {error} at {Path(place.filename).name}:{place.lineno}"
    finally:
        signal.alarm(0)
    started_kb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    return (FAILED, f"a process of {started_kb} kB") if started_kb * 1024 > MEMORY_BYTES else (outcome, text)


if __name__ == "__main__":
    print(fuzz(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) > 3 else 0))
