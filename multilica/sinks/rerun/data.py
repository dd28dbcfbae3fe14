# SPDX-License-Identifier: Apache-2.0
"""Figures, matches and decisions of a run as data that programs read from its recording."""

import math
import time
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import rerun as rr

from multilica import events
from multilica.geometry import RigidTransform
from multilica.results import Correspondences, PairKey
from multilica.sinks.drawing.shapes import sample_indices
from multilica.sinks.rerun.entity_paths import TIMINGS, pair_path
from multilica.sinks.rerun.input import log_in_slot
from multilica.sinks.rerun.scene import CLOCK_TIMELINE, RerunScene
from multilica.sinks.run_state import RunState
from multilica.sinks.text.log_lines import pair_label


def log_timings(scene: RerunScene) -> None:
    """Log the name of each stage at its start and end, back to back up to now, on the wall clock alone.

    Equal runs differ on that timeline only.
    """
    known_s = {stage: seconds for stage, seconds in scene.state.document.timing_s.items() if seconds is not None}
    if not known_s:
        return
    seconds = np.array(list(known_s.values()))
    ends_s = np.cumsum(seconds)
    edges_s = np.stack([ends_s - seconds, ends_s], axis=1).ravel() - ends_s[-1]
    times = (time.time_ns() + (1e9 * edges_s).astype(np.int64)).astype("datetime64[ns]")
    names = [stage for stage in known_s for _ in ("start", "end")]
    columns = rr.AnyValues.columns(stage=pa.array(names))
    scene.stream.send_columns(TIMINGS, [rr.TimeColumn(CLOCK_TIMELINE, timestamp=times)], columns)
    if times[0] < np.datetime64(scene.started_ns, "ns"):  # then views need the frames of the LiDARs there, too
        for lidar in scene.state.lidars:
            log_in_slot(scene, lidar, [rr.TimeColumn(CLOCK_TIMELINE, timestamp=times[:1])])


def log_matched(scene: RerunScene, event: events.CorrespondencesMatched) -> None:
    """Log the number of matches of a pair, and the matches."""
    matches = event.correspondences
    _log_scalars(scene, (matches.target, matches.source), "correspond", {"matches": len(matches)})
    _log_matches(scene, matches)


def log_hypotheses(scene: RerunScene, event: events.HypothesesFound) -> None:
    """Log the figures of a pair's hypotheses, and which of them each match agrees with."""
    found = event.coarse.hypotheses
    figures = {"hypotheses": len(found), "agreeing_matches": found[0].score if found else 0.0}
    _log_scalars(scene, (event.coarse.target, event.coarse.source), "coarse", figures)
    _log_agreement(scene, event.correspondences)


def log_verified(scene: RerunScene, event: events.HypothesesVerified) -> None:
    """Log the figures of the hypothesis with the most evidence."""
    if event.registrations:
        _log_scalars(scene, (event.target, event.source), "verify", event.registrations[0].figures)


def log_registration(
    scene: RerunScene, event: events.PairRegistered | events.VerdictChanged | events.LoopRegistered
) -> None:
    """Log the figures of a registered pair, and the residuals of its matches; none of a refused loop."""
    found = event.registration
    if isinstance(event, events.LoopRegistered) and not found.verdict.accepted:
        return
    pair = scene.state.pair_of(found)
    _log_scalars(scene, pair, "fine", found.figures)
    _log_residuals(scene, pair, found.T_target_source)


def candidate_pairs(state: RunState) -> tuple[PairKey, ...]:
    """Return the pairs of two LiDARs that a merge step could have chosen, in name order."""
    candidates = [one for decision in state.decisions for one in decision.candidates if not one.of_groups]
    return tuple(sorted({state.key_of(one.target, one.source) for one in candidates}))


def log_candidates(scene: RerunScene, event: events.MergeStepTaken) -> None:
    """Log the figures of the candidates of a merge step."""
    for pair in candidate_pairs(scene.state):
        label, colour = pair_label(*pair), scene.pair_colour(*pair)
        lines = rr.SeriesLines(names=label, colors=colour)
        points = rr.SeriesPoints(names=label, colors=colour, marker_sizes=5.0)
        scene.log(pair_path(*pair, "merge", "evidence"), lines, points)
    for one in event.decision.candidates:
        figures = {"evidence": one.evidence, "fitness": one.fitness, "rmse_m": one.rmse_m}
        stage = "merge_groups" if one.of_groups else "merge"
        _log_scalars(scene, scene.state.key_of(one.target, one.source), stage, figures)


def log_refined(scene: RerunScene, event: events.RigRefined) -> None:
    """Log how far the poses are from each registered pair."""
    for each in event.refinement.pairs:
        figures = {"residual_m": each.after_m, "residual_deg": each.after_deg, "weight": each.weight}
        _log_scalars(scene, scene.state.key_of(each.target, each.source), "refine", figures)


def _log_scalars(scene: RerunScene, pair: PairKey, stage: str, figures: Mapping[str, float | None]) -> None:
    for name, value in figures.items():
        if value is not None and math.isfinite(value):
            scene.log(pair_path(*pair, stage, name), rr.Scalars(float(value)))


def _rows_of(scene: RerunScene, count: int) -> npt.NDArray[np.intp]:
    return np.sort(sample_indices(count, scene.limits.match_rows))


def _log_matches(scene: RerunScene, matches: Correspondences) -> None:
    """Log the matches in their own frames; `--record full` keeps all."""
    rows = _rows_of(scene, len(matches))
    values = rr.AnyValues(
        target_index=pa.array(matches.target_index[rows], pa.int32()),
        source_index=pa.array(matches.source_index[rows], pa.int32()),
        target_point_m=_points(matches.target_points_m[rows]),
        source_point_m=_points(matches.source_points_m[rows]),
        feature_distance=pa.array(matches.feature_distances[rows], pa.float32()),
    )
    scene.log(_data_path(matches), values)


def _log_agreement(scene: RerunScene, matches: Correspondences) -> None:
    """Log which hypotheses each match agrees with."""
    rows = _rows_of(scene, len(matches))
    hypotheses = scene.state.coarse[matches.target, matches.source].hypotheses
    told = [one.inliers if len(one.inliers) else np.zeros(len(matches), dtype=np.bool_) for one in hypotheses]
    agree = np.array(told, dtype=np.bool_).reshape(len(told), len(matches)).T[rows]
    ends = np.concatenate([[0], np.cumsum(np.count_nonzero(agree, axis=1))])
    lists = pa.ListArray.from_arrays(pa.array(ends, pa.int32()), pa.array(np.nonzero(agree)[1], pa.int32()))
    scene.log(_data_path(matches), rr.AnyValues(agrees_with=lists))


def _log_residuals(scene: RerunScene, pair: PairKey, pose: RigidTransform) -> None:
    """Log the distance of the two points of each match at a pose."""
    matches = scene.state.matches.get(pair)
    if matches is None:
        return
    rows = _rows_of(scene, len(matches))
    moved_m = pose.with_target(pair[0]).apply(matches.source_points_m[rows])
    residual_m = np.linalg.norm(moved_m - matches.target_points_m[rows], axis=1)
    scene.log(_data_path(matches), rr.AnyValues(residual_m=pa.array(residual_m, pa.float32())))


def log_surface_matches(scene: RerunScene, event: events.SurfacesMatched) -> None:
    """Log the matches of surfaces at the final pose."""
    found = event.matches
    pair = scene.state.key_of(found.target, found.source)
    points = (found.target_points_m, found.source_points_m)
    of_target, of_source = points if found.target == pair[0] else points[::-1]
    rows = _rows_of(scene, len(found))
    values = rr.AnyValues(
        target_point_m=_points(of_target[rows]),
        source_point_m=_points(of_source[rows]),
        distance_m=pa.array(found.distance_m[rows], pa.float32()),
        plane_distance_m=pa.array(found.plane_distance_m[rows], pa.float32()),
    )
    scene.log(pair_path(*pair, "fine", "matches"), values)
    _log_residuals(scene, pair, found.T_target_source)


def _data_path(matches: Correspondences) -> str:
    return pair_path(matches.target, matches.source, "matches", "data")


def _points(points_m: npt.NDArray[np.floating]) -> pa.Array:
    return pa.FixedSizeListArray.from_arrays(pa.array(points_m.astype(np.float32).ravel()), 3)
