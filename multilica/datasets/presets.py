# SPDX-License-Identifier: Apache-2.0
"""The presets side by side on the scenes of a data set."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import tomli_w

from multilica import events
from multilica.config import CalibrationConfig, preset, with_overrides
from multilica.datasets.scene import DatasetScene
from multilica.errors import InputError
from multilica.events import RunObserver
from multilica.extrinsics import extrinsics_table
from multilica.run import run_calibration
from multilica.runs import SavedRun, Tolerances, Truth, read_run
from multilica.runs.paper_table import PaperTable, paper_table
from multilica.sinks.files.atomic import write_text_atomically
from multilica.sinks.mcap.snapshot_mcap import write_snapshot_mcap
from multilica.snapshot import Snapshot


@dataclass(slots=True, eq=False)
class PresetRuns:
    """The runs of one preset, those with a truth beside it; `stages_s` are the times of the stages of each run."""

    preset: str
    runs: list[SavedRun] = field(default_factory=list)
    truths: list[Truth] = field(default_factory=list)
    stages_s: list[float] = field(default_factory=list)

    @property
    def median_stages_s(self) -> float:
        """Median time of the stages of a run, in seconds; nan without runs."""
        return float(np.median(self.stages_s)) if self.stages_s else float("nan")

    def table(self, tolerances: Tolerances) -> PaperTable | None:
        """Compute the paper's table; None if no scene has a truth."""
        return paper_table(self.runs, self.truths, tolerances) if self.runs else None


@dataclass(frozen=True, slots=True, eq=False)
class DatasetRuns:
    """The runs on all scenes.

    Args:
        scenes: names of the scenes, in order.
        without_truth: those that no table includes.
        refused: what was not calibrated at all: scene, preset, reason.
    """

    scenes: tuple[str, ...]
    presets: tuple[PresetRuns, ...]
    without_truth: tuple[str, ...]
    refused: tuple[tuple[str, str, str], ...]


def run_presets(
    scenes: Iterable[DatasetScene],
    presets: Sequence[str],
    out: Path,
    *,
    target: str = "",
    settings: Sequence[str] = (),
    observe: RunObserver = events.ignore,
) -> DatasetRuns:
    """Calibrate each scene with each preset, in one process, into ``out/<scene>/<preset>``.

    ``out/<scene>`` also holds the scene as ``input.mcap``, and its truth as ``truth.toml``.

    Args:
        target: the target LiDAR; empty: that of the scene.
        settings: ``section.key=value``, applied to every preset.

    Raises:
        UsageError: an unknown preset, key or LiDAR.
        InputError: a scene cannot be read.
    """
    configs = {name: with_overrides(preset(name), ["runtime.workers=1", *settings]) for name in dict.fromkeys(presets)}
    found = {name: PresetRuns(name) for name in configs}
    names, without_truth, refused = [], [], []
    for scene in scenes:
        names.append(scene.name)
        folder = out / scene.name
        write_scene(scene, folder)
        if scene.truth is None:
            without_truth.append(scene.name)
        for name, config in configs.items():
            observe(events.SnapshotStarted(f"{scene.name}, preset {name}"))
            chosen = _config_of(config, scene.snapshot, target or scene.target)
            try:
                result = run_calibration(folder / "input.mcap", folder / name, chosen, observe=observe).result
            except InputError as error:
                refused.append((scene.name, name, str(error)))
                continue
            found[name].stages_s.append(sum(result.timing_s.values()))
            if scene.truth is not None:
                found[name].runs.append(read_run(folder / name))
                found[name].truths.append(Truth(str(folder / "truth.toml"), scene.truth))
    return DatasetRuns(tuple(names), tuple(found.values()), tuple(without_truth), tuple(refused))


def write_scene(scene: DatasetScene, folder: Path) -> None:
    """Write a scene as ``input.mcap``, with ``truth.toml`` if its truth is known."""
    folder.mkdir(parents=True, exist_ok=True)
    write_snapshot_mcap(scene.snapshot, folder / "input.mcap")
    if scene.truth is not None:
        write_text_atomically(folder / "truth.toml", tomli_w.dumps(extrinsics_table(scene.truth)))


def _config_of(config: CalibrationConfig, snapshot: Snapshot, target: str) -> CalibrationConfig:
    frames = max(len(lidar.scans) for lidar in snapshot.lidars)
    ingest = config.ingest.model_copy(update={"frames": frames})
    return config.model_copy(update={"target": target, "ingest": ingest})
