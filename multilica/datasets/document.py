# SPDX-License-Identifier: Apache-2.0
"""The runs on a data set as JSON."""

from collections.abc import Mapping
from typing import Literal

from pydantic import Field

from multilica.datasets.presets import DatasetRuns
from multilica.datasets.published import Published
from multilica.results.document.values import Entry, Number
from multilica.runs import Tolerances
from multilica.runs.paper_table import PaperTable


class PresetEntry(Entry):
    """One preset on all scenes; `table` is null if no scene has a truth."""

    median_stages_s: Number
    table: PaperTable | None


class RefusedEntry(Entry):
    """A scene that was not calibrated."""

    scene: str
    preset: str
    reason: str


class PublishedEntry(Entry):
    """Published statements and figures of the data set; `table` is null if no poses are published."""

    statements: tuple[str, ...]
    label: str
    table: PaperTable | None


class DatasetDocument(Entry):
    """The output of `multilica datasets --json`."""

    schema_: Literal["multilica/dataset/1"] = Field("multilica/dataset/1", alias="schema")
    dataset: str
    scenes: tuple[str, ...]
    without_truth: tuple[str, ...]
    refused: tuple[RefusedEntry, ...]
    presets: Mapping[str, PresetEntry]
    published: PublishedEntry


def dataset_document(dataset: str, found: DatasetRuns, known: Published, limits: Tolerances) -> DatasetDocument:
    """Convert the runs on a data set to their JSON document."""
    return DatasetDocument(
        dataset=dataset,
        scenes=found.scenes,
        without_truth=found.without_truth,
        refused=tuple(RefusedEntry(scene=one, preset=name, reason=why) for one, name, why in found.refused),
        presets={
            each.preset: PresetEntry(median_stages_s=each.median_stages_s, table=each.table(limits))
            for each in found.presets
        },
        published=PublishedEntry.of(known),
    )
