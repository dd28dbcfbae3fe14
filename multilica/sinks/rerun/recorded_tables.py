# SPDX-License-Identifier: Apache-2.0
"""Reader of the tables that recordings hold: pairs, matches, merge decisions and timings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from multilica.errors import UnreadableSourceError
from multilica.results import PairKey
from multilica.sinks.rerun.data_tables import MERGE_COLUMNS, PAIR_COLUMNS
from multilica.sinks.rerun.entity_paths import MERGE_TABLE, PAIR_TABLE, TIMINGS, pair_path
from multilica.sinks.rerun.reading import read_recorded_document
from multilica.sinks.rerun.rrd_process import read_batches

if TYPE_CHECKING:
    import pyarrow as pa

_STEP = "step"


def read_recorded_table(path: Path, name: str) -> pa.Table:
    """Read one of `TABLES` of a recording, also of one that was cut off; no rows if the run did not get there.

    Raises:
        UnreadableSourceError: no recording, a damaged one, or one of a version that recorded no tables.
    """
    found = TABLES[name](path)
    if found.num_rows == 0 and not read_batches(path, [PAIR_TABLE])[PAIR_TABLE] and read_recorded_document(path).pairs:
        raise UnreadableSourceError(f"{path} has no tables: an earlier version of multilica wrote it; calibrate again.")
    return found


def _pairs(path: Path) -> pa.Table:
    return _latest_table(path, PAIR_TABLE, PAIR_COLUMNS)


def _merge(path: Path) -> pa.Table:
    return _latest_table(path, MERGE_TABLE, MERGE_COLUMNS)


def _latest_table(path: Path, entity: str, columns: Mapping[str, pa.DataType]) -> pa.Table:
    import pyarrow as pa

    cells = _latest_cells(read_batches(path, [entity])[entity])
    return pa.table({name: pa.array(cells.get(name, []), kind) for name, kind in columns.items()})


def _matches(path: Path) -> pa.Table:
    """Return a row per match of descriptors, with the hypotheses that it agrees with."""
    return _of_pairs(path, ("matches", "data"), _MATCH_COLUMNS)


def _surfaces(path: Path) -> pa.Table:
    """Return a row per match of surfaces at the final pose."""
    return _of_pairs(path, ("fine", "matches"), _SURFACE_COLUMNS)


def _of_pairs(path: Path, parts: Sequence[str], columns: Sequence[str]) -> pa.Table:
    import pyarrow as pa

    pairs = _pairs(path)
    keys: list[PairKey] = list(zip(pairs["target"].to_pylist(), pairs["source"].to_pylist(), strict=True))
    found = read_batches(path, [pair_path(*key, *parts) for key in keys])
    tables = [_pair_table(key, _latest_cells(found[pair_path(*key, *parts)]), columns) for key in keys]
    return pa.concat_tables(tables) if tables else pa.table({})


def _pair_table(pair: PairKey, cells: Mapping[str, Any], columns: Sequence[str]) -> pa.Table:
    import pyarrow as pa

    count = max(map(len, cells.values()), default=0)
    arrays: dict[str, Any] = {
        "target": pa.array([pair[0]] * count, pa.string()),
        "source": pa.array([pair[1]] * count, pa.string()),
    }
    for name in columns:
        cell = cells.get(name)
        if name.endswith("_point_m"):
            xyz = zip(*cell, strict=True) if cell else ((), (), ())
            for axis, values in zip("xyz", xyz, strict=True):
                arrays[f"{name[:-8]}_{axis}_m"] = pa.array(values, pa.float32())
        elif name == "agrees_with":
            texts = [" ".join(map(str, each)) for each in cell] if cell else [""] * count
            arrays[name] = pa.array(texts, pa.string())
        else:
            kind = pa.int32() if name.endswith("_index") else pa.float32()
            arrays[name] = pa.array(cell or [None] * count, kind)
    return pa.table(arrays)


def _timings(path: Path) -> pa.Table:
    """Return a row per stage with its seconds; reading is the stage `ingest`."""
    import pyarrow as pa

    stages: list[str] = []
    times_ns: list[int] = []
    for batch in read_batches(path, [TIMINGS])[TIMINGS]:
        stages += [cell[0] for cell in batch.column("stage").to_pylist()]
        times_ns += batch.column("log_time").cast(pa.int64()).to_pylist()
    seconds = [1e-9 * (end - start) for start, end in zip(times_ns[::2], times_ns[1::2], strict=True)]
    return pa.table({"stage": pa.array(stages[::2], pa.string()), "seconds": pa.array(seconds, pa.float64())})


def _latest_cells(batches: Sequence[Any]) -> dict[str, Any]:
    """Return the cell of each component at the latest step that has one."""
    import pyarrow as pa

    latest: dict[str, tuple[int, Any]] = {}
    for batch in batches:
        steps = batch.column(_STEP).to_pylist()
        for name in (field.name for field in batch.schema if pa.types.is_list(field.type)):
            for step, cell in zip(steps, batch.column(name).to_pylist(), strict=True):
                if cell is not None and (name not in latest or step >= latest[name][0]):
                    latest[name] = (step, cell)
    return {name: cell for name, (_, cell) in latest.items()}


_MATCH_COLUMNS = (
    "target_index",
    "source_index",
    "target_point_m",
    "source_point_m",
    "feature_distance",
    "agrees_with",
    "residual_m",
)
_SURFACE_COLUMNS = ("target_point_m", "source_point_m", "distance_m", "plane_distance_m")
TABLES: Mapping[str, Callable[[Path], pa.Table]] = MappingProxyType(
    {"pairs": _pairs, "matches": _matches, "surfaces": _surfaces, "merge": _merge, "timings": _timings}
)
"""What can be asked of a recording, with its reader."""
