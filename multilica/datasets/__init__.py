# SPDX-License-Identifier: Apache-2.0
"""Public data sets: their own files as scenes with truth, and the presets side by side on them."""

from collections.abc import Mapping

from multilica.datasets import edgar, helipr, opencalib
from multilica.datasets.presets import DatasetDocument, run_presets
from multilica.datasets.published import published
from multilica.datasets.scene import DatasetScene, Reader, SceneRequest

__all__ = [
    "READERS",
    "DatasetDocument",
    "DatasetScene",
    "Reader",
    "SceneRequest",
    "published",
    "run_presets",
]

READERS: Mapping[str, Reader] = {
    "edgar": edgar.read_scenes,
    "helipr": helipr.read_scenes,
    "opencalib": opencalib.read_scenes,
}
"""Data set -> its reader."""
