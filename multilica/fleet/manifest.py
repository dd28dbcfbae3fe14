# SPDX-License-Identifier: Apache-2.0
"""Manifests of logs: CSV or Parquet files with the columns `source` and, if known, `vehicle` and `time`."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from decimal import Decimal
from pathlib import Path
from typing import Any

from multilica.errors import UnreadableSourceError

MANIFEST_SUFFIXES = (".csv", ".parquet")
_COLUMNS = ("source", "vehicle", "time")
_DAY = re.compile(r"\d{8}", re.ASCII)
_NUMBER = re.compile(r"\d+(\.\d*)?(e\+?\d{1,2})?", re.ASCII | re.IGNORECASE)
_UNITS_NS = (10**9, 10**6, 10**3, 1)
_FIRST_NS, _END_NS = 315_532_800 * 10**9, 2**63  # 1980 to 2262, in which no number fits two units


@dataclass(frozen=True, slots=True)
class ManifestRow:
    """A log of a manifest; `vehicle` is empty and `time_ns` None if they are not given."""

    source: str
    vehicle: str
    time_ns: int | None


def read_manifest(path: Path) -> Iterator[ManifestRow]:
    """Yield the rows of a manifest.

    Raises:
        UnreadableSourceError: it cannot be read, or has a row without a source or with a time that is none.
    """
    import pyarrow as pa
    import pyarrow.csv as pacsv
    import pyarrow.dataset as pads

    kind = path.suffix[1:]
    # All is text in a CSV file, so that 007 stays the name of a vehicle.
    texts = pacsv.ConvertOptions(column_types=dict.fromkeys(_COLUMNS, pa.string()))
    try:
        table = pads.dataset(path, format=pads.CsvFileFormat(convert_options=texts) if kind == "csv" else kind)
        if "source" not in table.schema.names:
            raise UnreadableSourceError(
                f"The manifest {path} has the columns {', '.join(table.schema.names)[:200]}; expected source, and "
                "vehicle and time if they are known."
            )
        columns = [name for name in _COLUMNS if name in table.schema.names]
        for batch in table.to_batches(columns=columns, batch_size=4096):
            yield from _rows(path, dict(zip(columns, batch.columns, strict=True)))
    except (pa.ArrowException, OSError, ValueError) as error:
        raise UnreadableSourceError(f"The manifest {path} cannot be read as {kind.upper()}.") from error


def _rows(path: Path, columns: dict[str, Any]) -> Iterator[ManifestRow]:
    sources = _texts(path, "source", columns["source"])
    vehicles = _texts(path, "vehicle", columns["vehicle"]) if "vehicle" in columns else [""] * len(sources)
    times = _times_ns(path, columns["time"]) if "time" in columns else [None] * len(sources)
    for source, vehicle, time_ns in zip(sources, vehicles, times, strict=True):
        if not source:
            raise UnreadableSourceError(f"A row of the manifest {path} has no source.")
        yield ManifestRow(source, vehicle, time_ns)


def _texts(path: Path, name: str, column: Any) -> list[str]:  # noqa: ANN401 - an array of Arrow
    """Return the values of a column as texts, empty for null."""
    import pyarrow as pa

    try:
        return [(value or "").strip() for value in column.cast(pa.string()).to_pylist()]
    except pa.ArrowException as error:
        raise UnreadableSourceError(
            f"The column {name} of the manifest {path} is of the type {column.type}; expected text."
        ) from error


def _times_ns(path: Path, column: Any) -> Sequence[int | None]:  # noqa: ANN401 - an array of Arrow
    """Return times in nanoseconds; a timestamp without a zone is UTC."""
    import pyarrow as pa

    if not (pa.types.is_timestamp(column.type) or pa.types.is_date(column.type)):
        return [_time_ns(path, text) if text else None for text in _texts(path, "time", column)]
    try:
        times: list[int | None] = column.cast(pa.timestamp("ns")).cast(pa.int64()).to_pylist()
    except pa.ArrowException as error:
        raise UnreadableSourceError(
            f"The manifest {path} has a time that 64 bits of nanoseconds cannot hold; expected the years 1678 to 2262."
        ) from error
    return times


def _time_ns(path: Path, text: str) -> int:
    """Return the time of a text in ISO 8601, or of a number in the unit that gives a year from 1980 to 2262."""
    found: int | None = None
    if _DAY.fullmatch(text) or not _NUMBER.fullmatch(text):
        found = _iso_ns(text)
    else:
        times = (int(Decimal(text) * unit) for unit in _UNITS_NS)
        found = next((time_ns for time_ns in times if _FIRST_NS <= time_ns < _END_NS), None)
    if found is None:
        raise UnreadableSourceError(
            f"The manifest {path} has the time {text!r:.60}; expected ISO 8601, YYYYMMDD, or a number of s, ms, us or "
            "ns since 1970."
        )
    return found


def _iso_ns(text: str) -> int | None:
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return None
    aware = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    time_ns = round(aware.timestamp() * 10**6) * 1000
    return time_ns if -_END_NS <= time_ns < _END_NS else None
