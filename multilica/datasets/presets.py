# SPDX-License-Identifier: Apache-2.0
"""The presets side by side on the scenes of a data set, and statements of the paper and its published code on it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import tomli_w
from pydantic import Field

from multilica import events
from multilica.acceptance.placement import place, place_target
from multilica.config import AcceptanceConfig, CalibrationConfig, preset, with_overrides
from multilica.datasets.folders import AGREED
from multilica.datasets.scene import MAIN_LIDAR, DatasetScene, extrinsics_of
from multilica.errors import InputError
from multilica.events import RunObserver
from multilica.extrinsics import Extrinsics, extrinsics_table
from multilica.geometry import RigidTransform
from multilica.results.values import Entry, Number
from multilica.run import run_calibration
from multilica.runs import SavedRun, Tolerances, Truth, read_run
from multilica.runs.paper_table import PaperTable, paper_table
from multilica.sinks.files.atomic import write_text_atomically
from multilica.sinks.snapshots import write_snapshot_mcap


class PresetFigures(Entry):
    """One preset on all scenes: the median time of the stages, and the table; null without runs, or without truths."""

    median_stages_s: Number
    table: PaperTable | None


class RefusedScene(Entry):
    """A scene that was not calibrated."""

    scene: str
    preset: str
    reason: str


class Published(Entry):
    """Published statements on a data set.

    Args:
        statements: sentences with the figures that the paper's text gives.
        label: origin of the table.
        table: errors of published poses; None if no poses are published.
    """

    statements: tuple[str, ...]
    label: str = ""
    table: PaperTable | None = None


class DatasetDocument(Entry):
    """The runs on a data set, the output of `multilica datasets --json`; scenes in `without_truth` are in no table."""

    schema_: Literal["multilica/dataset/1"] = Field("multilica/dataset/1", alias="schema")
    dataset: str
    scenes: tuple[str, ...]
    without_truth: tuple[str, ...]
    refused: tuple[RefusedScene, ...]
    presets: Mapping[str, PresetFigures]
    published: Published


@dataclass(slots=True, eq=False)
class _PresetRuns:
    """The runs of one preset, those with a truth beside it; `stages_s` are the times of the stages of each run."""

    config: CalibrationConfig
    runs: list[SavedRun] = field(default_factory=list)
    truths: list[Truth] = field(default_factory=list)
    stages_s: list[float] = field(default_factory=list)


def run_presets(
    dataset: str,
    scenes: Iterable[DatasetScene],
    presets: Sequence[str],
    out: Path,
    limits: Tolerances,
    *,
    target: str = "",
    settings: Sequence[str] = (),
    observe: RunObserver = events.ignore,
) -> DatasetDocument:
    """Calibrate each scene of a data set with each preset, in one process, into ``out/<scene>/<preset>``.

    ``out/<scene>`` also holds the scene as ``input.mcap``, and its truth as ``truth.toml``.

    Args:
        limits: of the successes.
        target: the target LiDAR; empty: that of the scene.
        settings: ``section.key=value``, applied to every preset.

    Raises:
        UsageError: an unknown preset, key or LiDAR.
        InputError: a scene cannot be read.
    """
    forced = ["runtime.workers=1", *settings]
    found = {name: _PresetRuns(with_overrides(preset(name), forced)) for name in dict.fromkeys(presets)}
    names, without_truth, refused = [], [], []
    for scene in scenes:
        names.append(scene.name)
        folder, frames = out / scene.name, max(len(lidar.scans) for lidar in scene.snapshot.lidars)
        write_scene(scene, folder)
        if scene.truth is None:
            without_truth.append(scene.name)
        for name, each in found.items():
            observe(events.SnapshotStarted(f"{scene.name}, preset {name}"))
            ingest = each.config.ingest.model_copy(update={"frames": frames})
            chosen = each.config.model_copy(update={"target": target or scene.target, "ingest": ingest})
            try:
                result = run_calibration(folder / "input.mcap", folder / name, chosen, observe=observe).result
            except InputError as error:
                refused.append(RefusedScene(scene=scene.name, preset=name, reason=str(error)))
                continue
            each.stages_s.append(sum(result.timing_s.values()))
            if scene.truth is not None:
                each.runs.append(read_run(folder / name))
                each.truths.append(Truth(str(folder / "truth.toml"), scene.truth))
    return DatasetDocument(
        dataset=dataset,
        scenes=tuple(names),
        without_truth=tuple(without_truth),
        refused=tuple(refused),
        presets={
            name: PresetFigures(
                median_stages_s=np.median(each.stages_s) if each.stages_s else None,
                table=paper_table(each.runs, each.truths, limits) if each.runs else None,
            )
            for name, each in found.items()
        },
        published=published(dataset, limits),
    )


def write_scene(scene: DatasetScene, folder: Path) -> None:
    """Write a scene as ``input.mcap``, with ``truth.toml`` if its truth is known."""
    folder.mkdir(parents=True, exist_ok=True)
    write_snapshot_mcap(scene.snapshot, folder / "input.mcap")
    if scene.truth is not None:
        write_text_atomically(folder / "truth.toml", tomli_w.dumps(extrinsics_table(scene.truth)))


_EDGAR_TRUTH = extrinsics_of(
    MAIN_LIDAR,
    {
        "lidar_1": ((-0.050039, -0.618266, -0.221022), (19.761387, 9.671599, 4.528510)),
        "lidar_2": ((0.018654, -1.221301, -0.442371), (39.942722, -0.481893, 1.220711)),
        "lidar_3": ((-2.692778, -0.693569, -0.115395), (19.952691, -11.158757, -3.085323)),
    },
)
_EDGAR_FOUND = extrinsics_of(
    MAIN_LIDAR,
    {
        "lidar_1": ((-0.046233, -0.608358, -0.226190), (19.760776, 9.610586, 4.484262)),
        "lidar_2": ((-0.015583, -1.218402, -0.437538), (39.963394, -0.328178, 1.207404)),
        "lidar_3": ((-2.650400, -0.694726, -0.106108), (19.619962, -10.813416, -3.052343)),
    },
)
"""The example in ``evaluation/config.yaml`` of the published code: the truth, and one result."""
_OPENCALIB_ROWS = {
    "left": (
        (-0.022213, -0.995132, -0.096015, -0.000238),
        (0.704855, -0.083697, 0.704396, 0.601886),
        (-0.709003, -0.05203, 0.703283, -0.393956),
    ),
    "right": (
        (0.045961, 0.997354, 0.05632, -0.0272),
        (-0.695842, 0.072416, -0.714535, -0.567595),
        (-0.716723, -0.006349, 0.697329, -0.419906),
    ),
}
"""Rows of ``T_top_<lidar>`` that the published code finds on its demo, with its own parameters."""
_OPENCALIB_FOUND = Extrinsics(
    AGREED.target,
    {
        name: RigidTransform.from_rotation_translation(AGREED.target, name, np.array(rows)[:, :3], np.array(rows)[:, 3])
        for name, rows in _OPENCALIB_ROWS.items()
    },
)
_STATEMENTS: Mapping[str, tuple[str, ...]] = {
    "helipr": (
        "The paper shows its errors on ten samples of HeLiPR as box plots, without numbers.",
        "On one core of 3 GHz its method takes 3 s per sample on average, CROON 9 s.",
        "CROON did not place the Velodyne on two of the samples.",
        "The paper doubts the data set's truth of the Aeva, and reads these errors only relative to CROON's.",
    ),
    "edgar": (
        "The paper shows its errors on ten scenes of EDGAR as box plots, without numbers.",
        "On one core of 3 GHz its method takes 3 s per scene on average; CROON took 1300 s for the first.",
        "CROON fails for many scenes, the rear LiDAR above all.",
    ),
    "opencalib": (
        "The paper evaluates nothing on these scenes; the first one is the demo of its code.",
        "Four methods agree on the truth within 20 mm and 0.4 degrees; smaller errors are not significant.",
    ),
}
_TABLES = {
    "edgar": ("published code, its example scene", _EDGAR_FOUND, _EDGAR_TRUTH),
    "opencalib": ("published code, scene 0001", _OPENCALIB_FOUND, AGREED),
}
"""Data set -> label, poses found, and the truth."""


def published(dataset: str, tolerances: Tolerances | None = None) -> Published:
    """Return what is published on a data set: ``helipr``, ``edgar`` or ``opencalib``."""
    if dataset not in _TABLES:
        return Published(statements=_STATEMENTS[dataset])
    label, found, truth = _TABLES[dataset]
    placements = tuple(place(pose, None, AcceptanceConfig(), "published") for pose in found.T_target_source.values())
    run = SavedRun("published", found.target, (place_target(found.target), *placements))
    table = paper_table([run], [Truth("published truth", truth)], tolerances)
    return Published(statements=_STATEMENTS[dataset], label=label, table=table)
