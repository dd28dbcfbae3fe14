# SPDX-License-Identifier: Apache-2.0
"""Folders that `ros2 bag record` writes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from multilica.ingest.detect import PACKED_SUFFIXES, named_format

__all__ = ["are_one_bag", "missing_parts"]

_METADATA = "metadata.yaml"
_PART = re.compile(r"\s*-\s+[\"']?(.+?)[\"']?\s*")


def are_one_bag(folder: Path, recordings: Sequence[Path]) -> bool:
    """Whether files of a folder are parts of one bag, rather than recordings of their own."""
    if any(named_format(path) == "ros1" for path in recordings):
        return False
    # The parts of a split bag are NAME_0.db3, NAME_1.db3, ...; if the recorder dies, there is no metadata.yaml, and of
    # parts that it compresses, NAME_0.db3.zstd, the last is not compressed yet.
    stems = {re.sub(r"_\d+$", "", Path(_unpacked(path.name)).stem) for path in recordings}
    return (folder / _METADATA).is_file() or len(stems) == 1


def missing_parts(folder: Path, recordings: Sequence[Path]) -> tuple[str, ...]:
    """Files that metadata.yaml names and that are not there, compressed or not."""
    try:
        lines = (folder / _METADATA).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return ()
    held = {_unpacked(path.name) for path in recordings}
    named = [Path(name).name for name in _named_parts(lines)]
    return tuple(name for name in named if _unpacked(name) not in held)


def _named_parts(lines: Sequence[str]) -> list[str]:
    begins = [number for number, line in enumerate(lines) if line.strip() == "relative_file_paths:"]
    named: list[str] = []
    for line in lines[begins[0] + 1 :] if begins else ():
        found = _PART.fullmatch(line)
        if found is None:
            break
        named.append(found[1])
    return named


def _unpacked(name: str) -> str:
    suffix = next((suffix for suffix in PACKED_SUFFIXES if name.lower().endswith(suffix)), "")
    return name[: len(name) - len(suffix)]
