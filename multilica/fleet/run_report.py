# SPDX-License-Identifier: Apache-2.0
"""The report of a saved run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import UndefinedError

from multilica.errors import SourceNotFoundError, UnreadableSourceError
from multilica.fleet.run_documents import read_run_document
from multilica.geometry import RigidTransform
from multilica.sinks.report.contents import JudgedPoints, ReportContents
from multilica.sinks.report.page import report_html
from multilica.sinks.rerun_reading import read_recorded_cloud

__all__ = ["contents_of_run", "report_of_run"]


def report_of_run(path: Path) -> str:
    """The page of a run directory, its `result.json`, or a recording, also one that was cut off.

    The points that were judged in refused pairs, and what the reader of the input noticed, are only in the report that
    the run itself wrote.

    Raises:
        SourceNotFoundError: nothing there, or no recording.
        UnreadableSourceError: damaged, or not of a run.
    """
    contents = contents_of_run(path)
    try:
        return report_html(contents)
    except (KeyError, TypeError, ValueError, UndefinedError) as error:
        raise UnreadableSourceError(f"{path} is not a whole result: {error}.") from error


def contents_of_run(path: Path) -> ReportContents:
    """What the report of that run shows; raises as `report_of_run` does."""
    run = read_run_document(path)
    if run.recording is None:
        raise SourceNotFoundError(f"{path} has no recording beside it, which holds the clouds to draw.")
    recording = run.recording
    try:
        clouds = {name: read_recorded_cloud(recording, name).astype(np.float64) for name in run.document["lidars"]}
        judged = {(one["target"], one["source"]): _poses(one) for one in run.document["pairs"]}
    except (KeyError, TypeError, ValueError) as error:
        raise UnreadableSourceError(f"{path} is not a whole result: {error}.") from error
    return ReportContents(run.document, clouds, judged)


def _poses(pair: Mapping[str, Any]) -> tuple[JudgedPoints, ...]:
    """The judged poses without their points."""
    matrices = [one["T_target_source"] for one in pair["assessments"]] or [pair["T_target_source"]]
    transforms = [RigidTransform(pair["target"], pair["source"], np.asarray(one, dtype=np.float64)) for one in matrices]
    return tuple(JudgedPoints(one, np.empty((0, 3)), np.empty(0, dtype=np.uint8)) for one in transforms)
