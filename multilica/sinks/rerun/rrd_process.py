# SPDX-License-Identifier: Apache-2.0
"""Reader of recordings, whole or cut off, in a process of its own: Rerun's reader aborts on some damaged files."""

import json
import os
import resource
import shutil
import struct
import subprocess
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from multilica.errors import UnreadableSourceError
from multilica.scratch import scratch_folder

# An RRD file is a head, then messages: kind and length, 64 bits each, little-endian, then so many bytes. A message of
# kind 0 ends the stream; the reader refuses a file that ends within a message.
_MAGIC = b"RRF2"
_HEAD_BYTES = 12
_MESSAGE_HEAD = struct.Struct("<QQ")
_KNOWN_KINDS = range(1, 4)
_COMMAND = "from multilica.sinks.rerun.rrd_process import main; main()"
_REFUSED = 3
_TIMEOUT_S = 300.0
_MAX_MEMORY_BYTES = 16 * 2**30


def read_batches(path: Path, entities: Sequence[str]) -> dict[str, list[Any]]:
    """Return per entity the Arrow record batches logged to it; of a file that was cut off, all before the cut.

    Raises:
        UnreadableSourceError: no recording, or a damaged one.
    """
    import pyarrow as pa

    with scratch_folder() as folder:
        out = folder / "batches"
        request = json.dumps([str(path.absolute()), list(entities), str(out)])
        try:
            done = subprocess.run(  # noqa: S603
                [sys.executable, "-I", "-c", f"import sys; sys.path[:] = {sys.path!r}; {_COMMAND}"],
                input=request.encode(),
                capture_output=True,
                timeout=_TIMEOUT_S,
                check=False,
                env={**os.environ, "RUST_BACKTRACE": "0"},
            )
        except subprocess.TimeoutExpired:
            raise UnreadableSourceError(
                f"{path} is a damaged recording: Rerun's reader did not end within {_TIMEOUT_S:.0f} s; calibrate again."
            ) from None
        if done.returncode == _REFUSED:
            why = done.stderr.decode(errors="replace").strip()
            raise UnreadableSourceError(f"{path} is not a recording that can be read: {why}.")
        if done.returncode != 0:
            raise UnreadableSourceError(
                f"{path} is a damaged recording: Rerun's reader crashed on it; calibrate again."
            )
        found: dict[str, list[Any]] = {entity: [] for entity in entities}
        with out.open("rb") as file:
            while line := file.readline():
                with pa.ipc.open_stream(file) as stream:
                    found[json.loads(line)] += list(stream)
        return found


def main() -> None:
    """Read the request on stdin, and write the batches: per batch a line with its entity, then an Arrow stream."""
    # A limit that this process was started with (ulimit -v) stays; only a privileged one could raise it.
    most = resource.getrlimit(resource.RLIMIT_AS)[1]
    limit = _MAX_MEMORY_BYTES if most == resource.RLIM_INFINITY else min(most, _MAX_MEMORY_BYTES)
    resource.setrlimit(resource.RLIMIT_AS, (limit, most))
    path, entities, out = json.loads(sys.stdin.read())
    import pyarrow as pa

    try:
        batches = _batches(Path(path), frozenset(entities))
    except (ValueError, OSError, RuntimeError) as error:
        sys.stderr.write(f"{error}")
        sys.exit(_REFUSED)
    with Path(out).open("wb") as file:
        for entity, batch in batches:
            file.write(f"{json.dumps(entity)}\n".encode())
            with pa.ipc.new_stream(file, batch.schema) as stream:
                stream.write_batch(batch)


def _batches(path: Path, entities: frozenset[str]) -> list[tuple[str, Any]]:
    from rerun.chunk import RrdReader

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="RRD file has no footer")
        with whole_part(path) as whole:
            chunks = RrdReader(whole).stream().to_chunks()
    return [(chunk.entity_path, chunk.to_record_batch()) for chunk in chunks if chunk.entity_path in entities]


@contextmanager
def whole_part(path: Path) -> Iterator[Path]:
    """Provide a file with all complete messages of a recording: the file itself if it was not cut off.

    A file that is no recording is provided as it is, and the reader refuses it.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        end = _end_of_whole_messages(file, size)
        if end is None:
            yield path
            return
        with scratch_folder() as folder:
            copy = folder / path.name
            file.seek(0)
            with copy.open("wb") as kept:
                shutil.copyfileobj(file, kept)
                kept.truncate(end)
            yield copy


def _end_of_whole_messages(file: BinaryIO, size: int) -> int | None:
    """Return where the last complete message ends; None if the file is complete, or no recording."""
    if file.read(_HEAD_BYTES)[: len(_MAGIC)] != _MAGIC:
        return None
    at = _HEAD_BYTES
    while at < size:
        file.seek(at)
        head = file.read(_MESSAGE_HEAD.size)
        if len(head) < _MESSAGE_HEAD.size:
            return at
        kind, length = _MESSAGE_HEAD.unpack(head)
        after = at + _MESSAGE_HEAD.size + length
        if kind == 0 and after <= size:
            return None
        if kind not in _KNOWN_KINDS or after > size:
            return at
        at = after
    return None
