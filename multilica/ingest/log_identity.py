# SPDX-License-Identifier: Apache-2.0
"""Vehicle and time of a log, from the log itself."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path

from multilica.config import IngestConfig
from multilica.documents import MAX_YAML_BYTES, DocumentError, parse_yaml, read_limited
from multilica.errors import MultilicaError
from multilica.ingest.containers.mcap_metadata import mcap_metadata
from multilica.ingest.damage import DamagedRecordingError
from multilica.ingest.locate import PathLike, find_source, locate
from multilica.ingest.memory import limited_memory
from multilica.ingest.opening import open_source
from multilica.ingest.recording import sanitize_text
from multilica.ingest.remote.error_texts import ConnectionLostError
from multilica.ingest.remote.remote_file import SourceFile

VEHICLE_KEYS = ("vehicle", "vehicle_id", "vehicle_name", "robot", "robot_id")
"""Keys, in any metadata record of an MCAP file or in `custom_data` of a ROS 2 bag, of the vehicle's name."""

_LATEST_NS = 2**63


@dataclass(frozen=True, slots=True)
class LogIdentity:
    """Vehicle, empty if the log does not say it, and time of the first message, None if it has none."""

    vehicle: str
    time_ns: int | None


def identify_log(source: PathLike) -> LogIdentity:
    """Read vehicle and time of a log, as far as it can be read.

    Raises:
        ConnectionLostError: a server does not answer.
    """
    vehicle, time_ns = "", None
    try:
        file = locate(source)
        vehicle = next((texts[key] for texts in _metadata(file) for key in VEHICLE_KEYS if texts.get(key)), "")
        found = find_source(file)
        with limited_memory(IngestConfig().max_memory_mb, found.label), closing(open_source(found)) as recording:
            span = recording.span_ns([topic.name for topic in recording.topics])
            time_ns = span[0] if span and 0 < span[0] < _LATEST_NS else None
    except ConnectionLostError:
        raise
    except (MultilicaError, DamagedRecordingError, OSError):
        pass
    return LogIdentity(sanitize_text(vehicle), time_ns)


def _metadata(file: SourceFile) -> Iterator[Mapping[str, str]]:
    if isinstance(file, Path) and file.is_dir():
        yield _custom_data(file / "metadata.yaml")
        return
    yield from (record.metadata for record in mcap_metadata(file))
    if isinstance(file, Path):
        yield _custom_data(file.parent / "metadata.yaml")


def _custom_data(path: Path) -> Mapping[str, str]:
    with suppress(OSError, DocumentError, TypeError, KeyError, AttributeError):
        values = parse_yaml(read_limited(path, MAX_YAML_BYTES))["rosbag2_bagfile_information"]["custom_data"]
        return {str(key): str(value) for key, value in values.items()}
    return {}
