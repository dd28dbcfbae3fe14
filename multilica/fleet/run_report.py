# SPDX-License-Identifier: Apache-2.0
"""The report of a saved run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import UndefinedError

from multilica.errors import SourceNotFoundError, UnreadableSourceError
from multilica.fleet.run_documents import read_run_document, require_whole
from multilica.geometry import RigidTransform
from multilica.sinks.report.contents import JudgedPoints, ReportContents
from multilica.sinks.report.page import report_html
from multilica.sinks.rerun_reading import RecordedJudgement, read_recorded_cloud, read_recorded_judgement

__all__ = ["contents_of_run", "report_of_run"]

_SAME_POSE = 1e-4
"""Metres and radians: a recording holds poses in single precision."""


def report_of_run(path: Path) -> str:
    """The page of a run directory, its `result.json`, or a recording, also one that was cut off.

    What the reader of the input noticed is only in the report that the run itself wrote. Judged points are those that
    the recording kept.

    Raises:
        SourceNotFoundError: nothing there, or no recording.
        UnreadableSourceError: damaged, or not of a run.
    """
    contents = contents_of_run(path)
    try:
        with require_whole(path):
            return report_html(contents)
    except UndefinedError as error:
        raise UnreadableSourceError(f"{path} is not a whole result: {error}.") from error


def contents_of_run(path: Path) -> ReportContents:
    """What the report of that run shows; raises as `report_of_run` does."""
    run = read_run_document(path)
    if run.recording is None:
        raise SourceNotFoundError(f"{path} has no recording beside it, which holds the clouds to draw.")
    recording = run.recording
    with require_whole(path):
        clouds = {name: read_recorded_cloud(recording, name).astype(np.float64) for name in run.document["lidars"]}
        judged = {(one["target"], one["source"]): _judged(recording, one) for one in run.document["pairs"]}
    return ReportContents(run.document, clouds, judged)


def _judged(recording: Path, pair: Mapping[str, Any]) -> tuple[JudgedPoints, ...]:
    """The pose that was chosen, then the other one; nothing of a pair that was accepted, which no picture shows."""
    if pair["verdict"]["outcome"] == "accept":
        return ()
    found = read_recorded_judgement(recording, pair["target"], pair["source"])
    finalists = [_pose(pair, one["T_target_source"]) for one in pair["assessments"]]
    shown = [finalists[0] if finalists else _pose(pair, pair["T_target_source"])]
    shown += [found.rival] if found.rival is not None else []
    return tuple(_points_at(pose, finalists, found) for pose in shown)


def _pose(pair: Mapping[str, Any], matrix: object) -> RigidTransform:
    return RigidTransform(pair["target"], pair["source"], np.asarray(matrix, dtype=np.float64))


def _points_at(pose: RigidTransform, finalists: list[RigidTransform], found: RecordedJudgement) -> JudgedPoints:
    """Without points where the recording does not tell what the beams say of that pose."""
    rank = next((rank for rank, one in enumerate(finalists) if max(one.distance_to(pose)) < _SAME_POSE), None)
    if rank is None or rank >= len(found.labels):
        return JudgedPoints(pose, np.empty((0, 3)), np.empty(0, dtype=np.uint8))
    return JudgedPoints(pose, found.points_m.astype(np.float64), found.labels[rank])
