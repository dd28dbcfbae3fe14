# SPDX-License-Identifier: Apache-2.0
"""The presets side by side on the scenes of a data set."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import tomli_w
from pydantic import Field

from multilica import events
from multilica.config import CalibrationConfig, preset, with_overrides
from multilica.datasets.published import Published, published
from multilica.datasets.scene import DatasetScene
from multilica.errors import InputError
from multilica.events import RunObserver
from multilica.extrinsics import extrinsics_table
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

    def figures(self, limits: Tolerances) -> PresetFigures:
        return PresetFigures(
            median_stages_s=np.median(self.stages_s) if self.stages_s else None,
            table=paper_table(self.runs, self.truths, limits) if self.runs else None,
        )


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
        presets={name: each.figures(limits) for name, each in found.items()},
        published=published(dataset, limits),
    )


def write_scene(scene: DatasetScene, folder: Path) -> None:
    """Write a scene as ``input.mcap``, with ``truth.toml`` if its truth is known."""
    folder.mkdir(parents=True, exist_ok=True)
    write_snapshot_mcap(scene.snapshot, folder / "input.mcap")
    if scene.truth is not None:
        write_text_atomically(folder / "truth.toml", tomli_w.dumps(extrinsics_table(scene.truth)))
