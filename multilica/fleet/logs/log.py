# SPDX-License-Identifier: Apache-2.0
"""Logs of vehicles, each with its key."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import multilica
from multilica.config import CalibrationConfig

_END_BYTES = 1 << 20
# Settings that change no result.
_INDIFFERENT = {"runtime": {"workers"}, "record": {"detail", "max_megabytes"}}


@dataclass(frozen=True, slots=True)
class FleetLog:
    """A log of a vehicle.

    Args:
        address: path or address that it is read from.
        source: the same for tables: the path below what was given, or the address without secrets.
        fingerprint: of its content, without reading all of it.
        vehicle: its name; empty if neither manifest nor pattern gives it.
        time_ns: of its beginning; None if neither gives it.
    """

    address: str
    source: str
    size_bytes: int
    fingerprint: str
    vehicle: str = ""
    time_ns: int | None = None


def log_key(log: FleetLog, config_sha256: str) -> str:
    """Return the key of a log's row: equal if the same source is treated by the same version in the same way."""
    identity = [log.source, log.size_bytes, log.fingerprint, config_sha256, multilica.__version__]
    return hashlib.sha256(json.dumps(identity).encode()).hexdigest()[:32]


def config_digest(config: CalibrationConfig, calibrate: str) -> str:
    """Return the hash of all settings that a result depends on."""
    values = config.model_dump(mode="json", exclude=_INDIFFERENT)
    return hashlib.sha256(json.dumps([values, calibrate], sort_keys=True).encode()).hexdigest()[:16]


def fingerprint_of(path: Path) -> tuple[int, str]:
    """Return size in bytes and fingerprint of a file, or of the files of a folder: of each its first and last MiB."""
    files = sorted(each for each in path.rglob("*") if each.is_file()) if path.is_dir() else [path]
    digest, total = hashlib.sha256(), 0
    for file in files:
        size = file.stat().st_size
        digest.update(f"{file.relative_to(path)} {size}\n".encode(errors="replace"))
        with file.open("rb") as stream:
            digest.update(stream.read(_END_BYTES))
            if size > _END_BYTES:
                stream.seek(max(size - _END_BYTES, _END_BYTES))
                digest.update(stream.read(_END_BYTES))
        total += size
    return total, digest.hexdigest()[:32]
