# SPDX-License-Identifier: Apache-2.0
"""Reader of documents, clouds, scores and tables of recordings."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from multilica.errors import UnreadableSourceError
from multilica.geometry import RigidTransform
from multilica.results import PairKey
from multilica.results.document import ResultDocument, parse_result
from multilica.sinks.rerun.rrd_process import read_batches
from multilica.sinks.rerun.scene import MERGE_TABLE, PAIR_TABLE, RESULT, TIMINGS, lidar_path, pair_path
from multilica.sinks.rerun.tables import MERGE_COLUMNS, PAIR_COLUMNS

_TEXT = "TextDocument:text"
_POSITIONS = "Points3D:positions"
_CLASSES = "Points3D:class_ids"
_STEP = "step"
_MATCH_COLUMNS = (
    *("target_index", "source_index", "target_point_m", "source_point_m", "feature_distance", "agrees_with"),
    "residual_m",
)
_SURFACE_COLUMNS = ("target_point_m", "source_point_m", "distance_m", "plane_distance_m")


class RecordedScores(NamedTuple):
    """Scored points of a pair.

    Args:
        points_m: (N, 3) of the source, in its own frame; empty if the recording has none.
        labels: (N,) `BeamLabel` per pose, the latest first: the registrations by evidence, then the hypotheses.
        target_points_m, target_labels: the same of the target.
        competing_pose: `T_target_source` of the competing pose, if there is one.
    """

    points_m: npt.NDArray[np.float32]
    labels: tuple[npt.NDArray[np.uint8], ...]
    target_points_m: npt.NDArray[np.float32]
    target_labels: tuple[npt.NDArray[np.uint8], ...]
    competing_pose: RigidTransform | None


def read_recorded_document(path: Path) -> ResultDocument:
    """Read the latest result document of a recording.

    Raises:
        UnreadableSourceError: no recording, or cut off before the first stage ended.
    """
    texts = _cells(read_batches(path, [RESULT])[RESULT], _TEXT)
    if not texts:
        raise UnreadableSourceError(
            f"{path} has no {RESULT}, which `multilica calibrate` writes when its first stage ends; give the recording "
            "of a run."
        )
    found = (parse_result(path, text[0]) for text in reversed(texts))
    # Several may be logged at one step.
    return max(found, key=lambda one: (one.status != "unfinished", len(one.progress.finished if one.progress else ())))


def read_recorded_clouds(path: Path, lidars: Sequence[str]) -> dict[str, npt.NDArray[np.float32]]:
    """Read the points (N, 3) of LiDARs, each in its own frame: preprocessed, else raw; none if there are none.

    Raises:
        UnreadableSourceError: no recording, or a damaged one.
    """
    places = {lidar: [lidar_path(lidar, kind) for kind in ("preprocessed", "raw")] for lidar in lidars}
    found = read_batches(path, [place for both in places.values() for place in both])
    cells = {lidar: [_cells(found[place], _POSITIONS) for place in both] for lidar, both in places.items()}
    return {lidar: _points_m(cleaned or raw) for lidar, (cleaned, raw) in cells.items()}


def read_recorded_scores(path: Path, pairs: Sequence[PairKey]) -> dict[PairKey, RecordedScores]:
    """Read the scored points of each pair (target, source), in either order of the pair.

    Raises:
        UnreadableSourceError: no recording, or a damaged one.
    """
    kinds = (("scored", "source"), ("scored", "target"), ("competing", "pose"))
    both_ways = [key for target, source in pairs for key in ((target, source), (source, target))]
    found = read_batches(path, [pair_path(*key, *kind) for key in both_ways for kind in kinds])
    return {pair: _scores(found, *pair) for pair in pairs}


def _scores(found: Mapping[str, list[Any]], target: str, source: str) -> RecordedScores:
    key = (target, source) if found[pair_path(target, source, "scored", "source")] else (source, target)
    ends = zip(key, ("target", "source"), strict=True)
    scored = {lidar: _labelled(found[pair_path(*key, "scored", end)]) for lidar, end in ends}
    pose = _competing(found, *key)
    return RecordedScores(*scored[source], *scored[target], None if pose is None else pose.with_target(target))


def _labelled(scored: list[Any]) -> tuple[npt.NDArray[np.float32], tuple[npt.NDArray[np.uint8], ...]]:
    """Return the points, and their labels per pose, also of a pose for which none is labelled."""
    labels = (np.asarray(cell, dtype=np.uint8) for cell in reversed(_cells(scored, _CLASSES, empty=True)))
    return _points_m(_cells(scored, _POSITIONS)), tuple(labels)


def _competing(found: Mapping[str, list[Any]], target: str, source: str) -> RigidTransform | None:
    batches = found[pair_path(target, source, "competing", "pose")]
    translations, quaternions = (_cells(batches, f"Transform3D:{part}") for part in ("translation", "quaternion"))
    if not translations or not quaternions:
        return None
    return RigidTransform.from_xyz_quaternion(target, source, translations[-1][0], quaternions[-1][0])


def _points_m(cells: list[Any]) -> npt.NDArray[np.float32]:
    """Return the points (N, 3) of the last cell; none without cells."""
    return np.asarray(cells[-1], dtype=np.float32).reshape(-1, 3) if cells else np.empty((0, 3), dtype=np.float32)


def _cells(batches: list[Any], column: str, *, empty: bool = False) -> list[Any]:
    """Return the cells of a column in order of steps: rows of a file are not in order of time.

    Args:
        empty: keep cells of no values; those of a step at which the column was not logged are always left out.
    """
    found = [
        (step, cell)
        for batch in batches
        if column in batch.schema.names
        for step, cell in zip(batch.column(_STEP).to_pylist(), batch.column(column).to_pylist(), strict=True)
        if cell or (empty and cell is not None)
    ]
    return [cell for _, cell in sorted(found, key=lambda each: each[0])]


def read_recorded_table(path: Path, name: str) -> pa.Table:
    """Read one of `TABLES` of a recording, also of one that was cut off; no rows if the run did not get there.

    Raises:
        UnreadableSourceError: no recording, a damaged one, or one of a version that recorded no tables.
    """
    found = TABLES[name](path)
    if found.num_rows == 0 and not read_batches(path, [PAIR_TABLE])[PAIR_TABLE] and read_recorded_document(path).pairs:
        raise UnreadableSourceError(f"{path} has no tables: an earlier version of multilica wrote it; calibrate again.")
    return found


def _latest_table(path: Path, entity: str, columns: Mapping[str, pa.DataType]) -> pa.Table:
    cells = _latest_cells(read_batches(path, [entity])[entity])
    return pa.table({name: pa.array(cells.get(name, []), kind) for name, kind in columns.items()})


def _of_pairs(path: Path, parts: Sequence[str], columns: Sequence[str]) -> pa.Table:
    pairs = _latest_table(path, PAIR_TABLE, PAIR_COLUMNS)
    keys: list[PairKey] = list(zip(pairs["target"].to_pylist(), pairs["source"].to_pylist(), strict=True))
    # Matches have the order in which the pair was matched, the table of pairs that of its registration.
    found = read_batches(path, [pair_path(*ends, *parts) for key in keys for ends in (key, key[::-1])])
    keys = [key if found[pair_path(*key, *parts)] else key[::-1] for key in keys]
    tables = [_pair_table(key, _latest_cells(found[pair_path(*key, *parts)]), columns) for key in keys]
    return pa.concat_tables(tables or [_pair_table(("", ""), {}, columns)])  # a header without pairs too


def _pair_table(pair: PairKey, cells: Mapping[str, Any], columns: Sequence[str]) -> pa.Table:
    count = max(map(len, cells.values()), default=0)
    ends = {"target": pair[0], "source": pair[1]}
    arrays: dict[str, Any] = {end: pa.array([lidar] * count, pa.string()) for end, lidar in ends.items()}
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
    stages: list[str] = []
    times_ns: list[int] = []
    for batch in read_batches(path, [TIMINGS])[TIMINGS]:
        stages += [cell[0] for cell in batch.column("stage").to_pylist()]
        times_ns += batch.column("log_time").cast(pa.int64()).to_pylist()
    seconds = [1e-9 * (end - start) for start, end in zip(times_ns[::2], times_ns[1::2], strict=True)]
    return pa.table({"stage": pa.array(stages[::2], pa.string()), "seconds": pa.array(seconds, pa.float64())})


def _latest_cells(batches: Sequence[Any]) -> dict[str, Any]:
    """Return the cell of each component at the latest step that has one."""
    latest: dict[str, tuple[int, Any]] = {}
    for batch in batches:
        steps = batch.column(_STEP).to_pylist()
        for name in (field.name for field in batch.schema if pa.types.is_list(field.type)):
            for step, cell in zip(steps, batch.column(name).to_pylist(), strict=True):
                if cell is not None and (name not in latest or step >= latest[name][0]):
                    latest[name] = (step, cell)
    return {name: cell for name, (_, cell) in latest.items()}


TABLES: Mapping[str, Callable[[Path], pa.Table]] = {
    "pairs": partial(_latest_table, entity=PAIR_TABLE, columns=PAIR_COLUMNS),
    "matches": partial(_of_pairs, parts=("matches", "data"), columns=_MATCH_COLUMNS),
    "surfaces": partial(_of_pairs, parts=("fine", "matches"), columns=_SURFACE_COLUMNS),
    "merge": partial(_latest_table, entity=MERGE_TABLE, columns=MERGE_COLUMNS),
    "timings": _timings,
}
"""Tables of a recording, each with its reader: `matches` are of descriptors, `surfaces` at the final pose."""
