# SPDX-License-Identifier: Apache-2.0
"""The summary of a run as markdown."""

from collections.abc import Iterator, Sequence

from multilica.diagnosis import Explanation, Missing, Uncertain, explain
from multilica.results import CalibrationResult, LidarPlacement
from multilica.results.document import ResultDocument
from multilica.sinks.drawing.shapes import SIGMAS, ellipsoid_scale
from multilica.sinks.run_state import RunState
from multilica.sinks.text.markdown import escaped, markdown_table

# As narrow as it can be: the viewer cuts what is wider than its pane.
_PLACEMENT_HEADER = ("LiDAR", "x m", "y m", "z m", "roll °", "pitch °", "yaw °", "sigma mm", "sigma °")


def summary_markdown(state: RunState, document: ResultDocument | None, ended_by: str = "") -> str:
    """Summarise the outcome, or the progress of a run that has none yet.

    Args:
        document: of that state, see `run_document`.
        ended_by: why the run ended early.
    """
    parts = [
        *([] if document is None else _explanation_parts(explain(document))),
        f"The run ended early: **{escaped(ended_by)}**" if ended_by else "",
        *_result_parts(state.result),
        _input_part(state),
        _version_part(state),
    ]
    return "\n\n".join(part for part in parts if part)


def _explanation_parts(explanation: Explanation) -> Iterator[str]:
    yield f"# {explanation.headline}"
    if explanation.warnings:
        yield "\n".join(f"- **Warning**: {warning}" for warning in explanation.warnings)
    if explanation.known:
        yield "\n".join(f"- {known}" for known in explanation.known)
    for missing in explanation.missing:
        yield _missing_part(missing)
    for uncertain in explanation.uncertain:
        yield _uncertain_part(uncertain)
    if explanation.advice:
        yield "\n".join(f"- What helps: {advice}." for advice in explanation.advice)


def _missing_part(missing: Missing) -> str:
    lines = [f"- **{missing.headline}**", f"  - At stage {missing.step}."]
    if missing.decisive is not None:
        lines.append(f"  - Decisive: {missing.decisive.sentence}")
    if missing.next_best:
        lines.append(f"  - Next best: {missing.next_best}")
    if missing.by_snapshot:
        lines.append(f"  - By snapshot: {missing.by_snapshot}")
    return "\n".join([*lines, *_advice_lines(missing.advice)])


def _uncertain_part(uncertain: Uncertain) -> str:
    return "\n".join([f"- **{uncertain.headline}**", *_advice_lines(uncertain.advice)])


def _advice_lines(advice: Sequence[str]) -> Iterator[str]:
    return (f"  - What helps: {each}." for each in advice)


def _result_parts(result: CalibrationResult | None) -> Iterator[str]:
    if result is None or result.refusal is not None:
        return
    if any(place.T_target_source is not None and place.lidar != result.target for place in result.placements):
        yield f"Target: **{escaped(result.target)}** ({escaped(result.target_reason)})"
    yield markdown_table(_PLACEMENT_HEADER, [_placement_row(place) for place in result.placements])
    if any(place.covariance is not None for place in result.placements):
        scale = ellipsoid_scale(result.placements)
        yield f"Ellipsoids of the rig: {SIGMAS:g} sigma of the position, {scale:g} times enlarged."
    if result.snapshots:
        yield "\n".join(f"- snapshot **{escaped(each.name)}**: {escaped(each.text)}" for each in result.snapshots)
    if result.ground is not None:
        yield f"Ground, frame {escaped(result.ground.frame)}: {escaped(result.ground.text)}."


def _placement_row(place: LidarPlacement) -> Sequence[str]:
    if place.T_target_source is None:
        return (f"{place.lidar} (**not placed**)", *("-",) * 8)
    pose = place.T_target_source
    numbers = (*(f"{value:z.3f}" for value in pose.xyz_m), *(f"{value:z.2f}" for value in pose.rpy_deg))
    xyz_m, rotation_deg = place.sigma_xyz_m, place.sigma_rotation_deg
    sigmas = ("-", "-")
    if xyz_m is not None and rotation_deg is not None:
        sigmas = (f"{1e3 * xyz_m.max():.1f}", f"{rotation_deg.max():.3f}")
    name = f"{place.lidar} (**uncertain**)" if place.uncertain else place.lidar
    return (name, *numbers, *sigmas)


def _input_part(state: RunState) -> str:
    if state.snapshot is None:
        return ""
    rows = [
        (lidar.name, lidar.topic or "-", str(len(lidar.scans)), f"{lidar.points_count:,}")
        for lidar in state.snapshot.lidars
    ]
    digest = state.snapshot.source_sha256[:16] or "none"
    source = f"## Input\n\n`{state.snapshot.source or 'in memory'}`, sha256 `{digest}`"
    return f"{source}\n\n{markdown_table(('LiDAR', 'topic', 'frames', 'points'), rows)}"


def _version_part(state: RunState) -> str:
    if state.provenance is None:
        return ""
    return ", ".join(f"{package} {version}" for package, version in state.provenance.versions.items())
