# SPDX-License-Identifier: Apache-2.0
"""Statements of the paper and its published code on each data set."""

from collections.abc import Mapping

import numpy as np

from multilica.acceptance.placement import place, place_target
from multilica.config import AcceptanceConfig
from multilica.datasets.folders import AGREED
from multilica.datasets.scene import MAIN_LIDAR, extrinsics_of
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.results.values import Entry
from multilica.runs import SavedRun, Tolerances, Truth
from multilica.runs.paper_table import PaperTable, paper_table


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
