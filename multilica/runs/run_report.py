# SPDX-License-Identifier: Apache-2.0
"""Report of a saved run, and its picture."""

from pathlib import Path

import numpy as np

from multilica.errors import SourceNotFoundError, UsageError
from multilica.geometry import RigidTransform
from multilica.results import LEVEL_FRAME
from multilica.results.document import PairEntry
from multilica.runs.run_documents import read_run_document
from multilica.sinks.report.contents import SAME_POSE, ReportContents, ScoredPoints, finalists
from multilica.sinks.rerun.reading import RecordedScores, read_recorded_clouds, read_recorded_scores
from multilica.sinks.rerun.viewer import viewer_picture
from multilica.stages.ground import estimate_level

_SIDE_PX = (64, 8192)


def contents_of_run(path: Path) -> ReportContents:
    """Return what `report_html` shows of a run directory, its `result.json`, or a recording, also a cut-off one.

    Clouds and scored points are those that the recording kept.

    Raises:
        SourceNotFoundError: nothing there, or no recording.
        UnreadableSourceError: damaged, or not of a run.
    """
    run = read_run_document(path)
    if run.recording is None:
        raise SourceNotFoundError(f"{path} has no recording (.rrd) beside it, which has the clouds to draw.")
    document = run.document
    recorded = read_recorded_clouds(run.recording, list(document.lidars))
    clouds = {name: points_m.astype(np.float64) for name, points_m in recorded.items()}
    # No picture shows an accepted pair.
    shown = {pair.key: pair for pair in document.pairs if not pair.verdict.accepted}
    scores = read_recorded_scores(run.recording, list(shown))
    scored = {pair.key: _scored(scores[pair.key], pair) if pair.key in shown else () for pair in document.pairs}
    target = document.target or next(iter(document.lidars))
    level = (
        estimate_level(target, clouds, document.poses, document.config)
        if document.ground is None
        else RigidTransform(LEVEL_FRAME, target, np.asarray(document.ground.T_base_target, dtype=np.float64))
    )
    return ReportContents(document, clouds, scored, level)


def _scored(found: RecordedScores, pair: PairEntry) -> tuple[ScoredPoints, ...]:
    """Return the chosen pose, then the competing one, each with its points if the recording has its score."""
    poses = (*(finalists(pair)[:1] or [pair.pose]), found.competing_pose)
    return tuple(_points_at(pose, found, pair) for pose in poses if pose is not None)


def _points_at(pose: RigidTransform, found: RecordedScores, pair: PairEntry) -> ScoredPoints:
    rank = next((rank for rank, one in enumerate(finalists(pair)) if max(one.distance_to(pose)) < SAME_POSE), None)
    if rank is None or rank >= min(len(found.labels), len(found.target_labels)):
        return ScoredPoints(pose)
    score, labels, target_labels = pair.registrations[rank], found.labels[rank], found.target_labels[rank]
    points_m, target_points_m = (each_m.astype(np.float64) for each_m in (found.points_m, found.target_points_m))
    if (len(labels), len(target_labels)) != (len(points_m), len(target_points_m)):
        return ScoredPoints(pose)  # none of its points is scored
    counts = (score.agree, score.violate, score.occluded, score.evidence or 0.0)
    return ScoredPoints(pose, points_m, labels, target_points_m, target_labels, *counts)


def recording_of_run(path: Path) -> Path:
    """Return the recording of a run directory, whole or cut off, or the recording itself.

    Raises:
        SourceNotFoundError: nothing there, or no recording.
    """
    if path.suffix == ".rrd" and path.is_file():
        return path
    recording = read_run_document(path).recording
    if recording is None:
        raise SourceNotFoundError(f"{path} has no recording beside it, which `multilica calibrate` writes.")
    return recording


def first_part_of(path: Path) -> Path | None:
    """Return the run of the first snapshot of a joint run that has one; None if the run is of one snapshot."""
    folder = path if path.is_dir() else path.parent
    parts = (folder / snapshot.name for snapshot in read_run_document(path).document.snapshots)
    return next((part for part in parts if part.is_dir()), None)


def picture_of_run(path: Path, size_px: tuple[int, int]) -> bytes:
    """Draw the first view of a run directory or a recording as PNG of that width and height, without a screen.

    Raises:
        SourceNotFoundError: nothing there, or no recording.
        UnreadableSourceError: damaged, or not of a run.
        UsageError: the size is out of range.
        ViewerError: Rerun's viewer does not run here.
    """
    if not all(_SIDE_PX[0] <= side <= _SIDE_PX[1] for side in size_px):
        raise UsageError(
            f"Found a picture size of {size_px[0]} x {size_px[1]} pixels; expected {_SIDE_PX[0]} to {_SIDE_PX[1]} "
            "per side."
        )
    return viewer_picture(recording_of_run(path), size_px)
