# SPDX-License-Identifier: Apache-2.0
"""Entity paths of a recording with its frames, as `docs/recording-layout.md` lists them."""

import rerun as rr

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
MERGE_STEPS = "/merge/steps"
PAIR_TABLE = "/tables/pairs"
MERGE_TABLE = "/tables/merge"
TIMINGS = "/timings"
GROUND = "/ground"
FRAMES = "/frames"

DISPLAY_FRAME = "display"
ROOT_FRAME = "tf#/"
"""Rerun's own name for the frame of entities that no frame is logged for."""

CURVES = {
    "fitness": "fitness within GICP's distance",
    "error": "GICP cost",
    "translation_step_m": "translation per step, m",
    "rotation_step_rad": "rotation per step, rad",
}
"""Fields of `GicpStep` with the titles of their plots."""


def lidar_path(lidar: str, *parts: str) -> str:
    """Return an entity path of one LiDAR."""
    return rr.new_entity_path(["lidars", lidar, *parts])


def pair_path(target: str, source: str, *parts: str) -> str:
    """Return an entity path of one pair."""
    return rr.new_entity_path(["pairs", target, source, *parts])


def curve_path(quantity: str, target: str = "", source: str = "", start: str = "") -> str:
    """Return the path of a GICP curve of a pair from a start; without a pair, the parent of all curves."""
    return rr.new_entity_path(["gicp", quantity, *(part for part in (target, source, start) if part)])


def lidar_frame(lidar: str) -> str:
    """Return the LiDAR's own frame."""
    return f"lidar/{lidar}"


def slot_frame(lidar: str) -> str:
    """Return the display-only frame of a LiDAR without a pose."""
    return f"slot/{lidar}"


def pair_frame(target: str, source: str, name: str) -> str:
    """Return a frame of a pair's source, named by its pose, or ``before``, ``competing`` or ``lifted``."""
    return f"pair/{target}/{source}/{name}"
