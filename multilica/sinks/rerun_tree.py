# SPDX-License-Identifier: Apache-2.0
"""The entity paths and frames of a recording, as `docs/recording-layout.md` lists them."""

from __future__ import annotations

import rerun as rr

__all__ = [
    "CONFIG",
    "COVERAGE",
    "DISPLAY_FRAME",
    "DROPPED_TABLE",
    "FITNESS",
    "GROUND",
    "HYPOTHESES_TABLE",
    "LOG",
    "MERGE_CANDIDATES",
    "MERGE_GRAPH",
    "PAIRS",
    "PAIRS_TABLE",
    "RESULT",
    "SUMMARY",
    "VERDICTS",
    "before_frame",
    "curve_path",
    "hypothesis_frame",
    "lidar_frame",
    "lidar_path",
    "lifted_frame",
    "pair_path",
    "slot_frame",
]

LOG = "/log"
SUMMARY = "/summary"
CONFIG = "/config"
RESULT = "/result"
DROPPED_TABLE = "/dropped"
PAIRS = "/pairs"
FITNESS = "/fitness"
COVERAGE = "/coverage"
VERDICTS = "/verdicts"
PAIRS_TABLE = "/pair_figures"
HYPOTHESES_TABLE = "/hypotheses"
MERGE_GRAPH = "/merge/graph"
MERGE_CANDIDATES = "/merge/candidates"
GROUND = "/ground"

DISPLAY_FRAME = "display"


def lidar_path(lidar: str, *parts: str) -> str:
    """An entity of one LiDAR."""
    return rr.new_entity_path(["lidars", lidar, *parts])


def pair_path(target: str, source: str, *parts: str) -> str:
    """An entity of one pair."""
    return rr.new_entity_path(["pairs", target, source, *parts])


def curve_path(quantity: str, target: str = "", source: str = "", start: str = "") -> str:
    """A curve of GICP: what is measured, of which pair, from which start; without a pair the parent of all."""
    return rr.new_entity_path(["gicp", quantity, *(part for part in (target, source, start) if part)])


def lidar_frame(lidar: str) -> str:
    """The LiDAR's own frame."""
    return f"lidar/{lidar}"


def slot_frame(lidar: str) -> str:
    """Where a LiDAR that has no pose is shown, beside the others; no pose of anything."""
    return f"slot/{lidar}"


def hypothesis_frame(target: str, source: str, start: str) -> str:
    """The source's frame as one hypothesis of a pair places it."""
    return f"pair/{target}/{source}/{start}"


def before_frame(target: str, source: str) -> str:
    """The source's frame as the coarse stage placed it, before any GICP."""
    return f"pair/{target}/{source}/before"


def lifted_frame(target: str, source: str) -> str:
    """The source's frame as the best hypothesis places it, lifted so that matches can be seen."""
    return f"pair/{target}/{source}/lifted"
