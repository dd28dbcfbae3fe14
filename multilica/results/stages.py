# SPDX-License-Identifier: Apache-2.0
"""Figures per stage in the result document, by which two runs can be compared."""

from collections.abc import Mapping
from typing import TypeVar

from pydantic import Field

from multilica.results.values import Entry, Number, Vector3

FiguresT = TypeVar("FiguresT")


class IngestFigures(Entry):
    """A LiDAR as it was read."""

    frames: int = Field(description="Number of frames.")
    points: int = Field(description="Number of points.")
    digest: str = Field(description="Hash of the points.")


class PreprocessFigures(Entry):
    """A LiDAR after preprocessing."""

    returns: int = Field(description="Number of returns before.")
    points: int = Field(description="Number of points after.")
    dropped: Mapping[str, int] = Field(description="Number of dropped returns per reason.")
    digest: str = Field(description="Hash of the points.")


class FeatureFigures(Entry):
    """Features of a LiDAR."""

    points: int = Field(description="Number of points with a descriptor.")
    digest: str = Field(description="Hash of points and descriptors.")


class CorrespondFigures(Entry):
    """Matches of a pair."""

    matches: int = Field(description="Number of matches.")
    digest: str = Field(description="Hash of the matched points.")


class CoarseFigures(Entry):
    """Hypotheses of a pair; the pose is that of the first."""

    hypotheses: int = Field(description="Number of hypotheses.")
    graph_nodes: int = Field(description="Nodes of the consistency graph.")
    graph_edges: int = Field(description="Connections of the consistency graph.")
    clique_size: int = Field(0, description="Members of its largest clique that was found.")
    solver: str = Field("", description="The solver that ran; empty if it found no hypothesis.")
    score: Number = Field(None, description="Number of matches that agree with the first hypothesis.")
    xyz_m: Vector3 | None = Field(None, description="Position.")
    rpy_deg: Vector3 | None = Field(None, description="Roll, pitch, yaw, extrinsic xyz.")


class VerifyFigures(Entry):
    """Hypotheses of a pair after verification; all figures but the first are those of the best."""

    distinct: int = Field(description="Number of distinct poses.")
    agree: int | None = Field(None, description="Points on a surface that the other LiDAR measured.")
    violate: int | None = Field(None, description="Points in space that beams of the other LiDAR passed through.")
    evidence: Number = Field(None, description="Log-odds that the pose is the true one.")
    xyz_m: Vector3 | None = Field(None, description="Position.")
    rpy_deg: Vector3 | None = Field(None, description="Roll, pitch, yaw, extrinsic xyz.")


class PoseFigures(Entry):
    """A pose."""

    xyz_m: Vector3 = Field(description="Position.")
    rpy_deg: Vector3 = Field(description="Roll, pitch, yaw, extrinsic xyz.")


class FineFigures(PoseFigures):
    """Registration of a pair."""

    verdict: str = Field(description="The decision on the pair.")
    fitness: Number = Field(description="Share of the source points that lie near a surface of the target cloud.")
    rmse_m: Number = Field(description="RMS distance of those points to their nearest target point.")


class MergeFigures(Entry):
    """A merge step."""

    chosen: str | None = Field(description="The pair that was merged; null if none was.")
    fitness: Number = Field(description="Fitness of that pair.")
    groups: str = Field(description="Connected LiDARs after the step.")


class GroundFigures(Entry):
    """The ground plane."""

    offset_m: Number = Field(description="Height of the target above the ground.")
    normal: Vector3 = Field(description="Unit normal in the target frame, upwards.")


def _finished(description: str) -> Mapping[str, FiguresT] | None:
    """Declare the figures of a stage, which are left out of the document until the stage has finished."""
    return Field(default=None, description=description, exclude_if=lambda figures: figures is None)


class StageFigures(Entry):
    """Figures of each finished stage, per LiDAR, pair or step."""

    ingest: Mapping[str, IngestFigures] | None = _finished("Per LiDAR.")
    preprocess: Mapping[str, PreprocessFigures] | None = _finished("Per LiDAR.")
    features: Mapping[str, FeatureFigures] | None = _finished("Per LiDAR.")
    correspond: Mapping[str, CorrespondFigures] | None = _finished("Per pair, `target <- source`.")
    coarse: Mapping[str, CoarseFigures] | None = _finished("Per pair, as it was matched.")
    verify: Mapping[str, VerifyFigures] | None = _finished("Per pair, as it was matched.")
    fine: Mapping[str, FineFigures] | None = _finished("Per pair, as it was registered, `target <- source`.")
    merge: Mapping[str, MergeFigures] | None = _finished("Per step.")
    refine: Mapping[str, PoseFigures] | None = _finished("Per LiDAR.")
    ground: Mapping[str, GroundFigures] | None = _finished("The plane; empty if none was found.")
