# SPDX-License-Identifier: Apache-2.0
"""Public data sets: their own files as scenes with truth, and the presets side by side on them."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from multilica.datasets import helipr
from multilica.datasets.folders import read_edgar, read_opencalib
from multilica.datasets.presets import DatasetDocument, published, run_presets
from multilica.datasets.scene import DatasetScene, SceneRequest

__all__ = ["READERS", "DatasetDocument", "DatasetScene", "SceneRequest", "published", "run_presets"]

READERS: Mapping[str, Callable[[Path, SceneRequest], Iterator[DatasetScene]]] = {
    "edgar": read_edgar,
    "helipr": helipr.read_scenes,
    "opencalib": read_opencalib,
}
"""Data set -> its reader."""
