# SPDX-License-Identifier: Apache-2.0
"""How long one reader takes for one file, measured in a process of its own.

What a process did before changes what it costs to take memory from the system, threefold for some readers.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from contextlib import closing, suppress
from functools import partial
from pathlib import Path

from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader, make_reader

REPEATS = 4


def main(reader: str, path: Path) -> None:
    """Print as JSON: bytes of messages, points, and the seconds and processor seconds of the fastest of some runs."""
    times_s = []
    read = (0, 0)
    for _ in range(REPEATS):
        start_s, start_processor_s = time.perf_counter(), time.process_time()
        read = READERS[reader](path)
        times_s.append((time.perf_counter() - start_s, time.process_time() - start_processor_s))
    elapsed_s, processor_s = map(min, zip(*times_s, strict=True))
    print(json.dumps({"size": read[0], "points": read[1], "elapsed_s": elapsed_s, "processor_s": processor_s}))


def _decoded(path: Path) -> tuple[int, int]:
    from multilica.ingest.locate import find_source
    from multilica.ingest.message_types import decode_cloud, is_cloud
    from multilica.ingest.opening import open_source
    from multilica.ingest.recording import DamagedRecordingError

    size = points = 0
    with closing(open_source(find_source(path))) as recording, suppress(DamagedRecordingError):
        topics = {topic.name for topic in recording.topics if is_cloud(topic)}
        for message in recording.messages(topics):
            size += len(message.data)
            points += len(decode_cloud(message).scan.points_m)
    return size, points


def _iterated(path: Path, *, validate_crcs: bool = False) -> tuple[int, int]:
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=validate_crcs)
        return sum(len(message.data) for _, _, message in reader.iter_messages()), 0


def _iterated_from_the_front(path: Path, *, validate_crcs: bool = False) -> tuple[int, int]:
    size = 0
    with path.open("rb") as file, suppress(EndOfFile):
        reader = NonSeekingReader(file, validate_crcs=validate_crcs)
        for _, _, message in reader.iter_messages(log_time_order=False):
            size += len(message.data)
    return size, 0


READERS: dict[str, Callable[[Path], tuple[int, int]]] = {
    "decoded": _decoded,
    "bare": _iterated,
    "checked": partial(_iterated, validate_crcs=True),
    "bare from the front": _iterated_from_the_front,
    "checked from the front": partial(_iterated_from_the_front, validate_crcs=True),
}
"""The last two read what `make_reader` refuses: a file that ends too early."""


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
