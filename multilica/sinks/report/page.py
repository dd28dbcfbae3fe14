# SPDX-License-Identifier: Apache-2.0
"""HTML page of a report."""

import math
from collections.abc import Collection, Sequence
from contextlib import AbstractContextManager
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jinja2 import Template
from markupsafe import Markup

from multilica import events
from multilica.diagnosis import Missing
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.results import SnapshotReport
from multilica.results.document import PairEntry, ResultDocument
from multilica.sinks.drawing import AGREE, EDGE_LABEL_SHARE, OCCLUDED, VIOLATE, hex_colour
from multilica.sinks.files.atomic import write_text_atomically
from multilica.sinks.files.result_files import REPORT_HTML, calibration_toml, config_toml, matrix_text, urdf_text
from multilica.sinks.report.contents import ReportContents, contents_of
from multilica.sinks.report.drive_map import SIZE_PX, drive_maps, links_of
from multilica.sinks.report.figures import Figure, pair_figures, rig_figures, short_name
from multilica.sinks.report.rig import BYTES_PER_POINT, MAX_POINTS, refused_poses, rig_drawing, rig_scene
from multilica.sinks.report.template import own_text, page_template
from multilica.sinks.run_state import RunState

MAX_BYTES = 8_000_000
"""Limit of ticket systems and mail; the clouds of the 3-D view are thinned until the page fits."""

_MAX_PICTURED = 4
_MAX_LABELLED = 15
"""Pairs of the graph with numbers at each edge."""
_MAX_NAME = 15
"""Letters of a name in a drawing."""
_SLACK_BYTES = 20_000
"""Reserve for the text about thinning."""
_PACKAGE = "multilica.sinks.report"
_GRAPH_SIZE = (640, 420)
_GRAPH_RADII = (220.0, 150.0)


class ReportFile(AbstractContextManager["ReportFile"]):
    """A sink that writes `report.html` into a directory when the run is over, however it ended."""

    def __init__(self, directory: Path, state: RunState | None = None) -> None:
        self.directory = directory
        self._state = state or RunState()
        self._written = False

    def __call__(self, event: events.Event) -> None:
        """Update the state; write the report after the last event."""
        self._state(event)
        match event:
            case events.CalibrationStarted():
                _template()  # compiled while workers compute
            case events.CalibrationFinished():
                self._write()

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        """Write the report of a run that started and has no result."""
        if self._state.snapshot is not None and not self._written:
            self._write(f"{error}" if error is not None and f"{error}" else "The run was stopped early.")

    def _write(self, ended_early: str = "") -> None:
        write_text_atomically(self.directory / REPORT_HTML, report_html(contents_of(self._state, ended_early)))
        self._written = True


def report_html(contents: ReportContents) -> str:
    """Render the report as one self-contained page of at most `MAX_BYTES` bytes."""
    context = _context(contents)

    def page(max_points: int) -> str:
        return _template().render(context | {"scene": rig_scene(contents, max_points)})

    whole = page(MAX_POINTS)
    if len(whole.encode()) <= MAX_BYTES:
        return whole
    spare_points = (MAX_BYTES - len(page(0).encode()) - _SLACK_BYTES) // BYTES_PER_POINT
    return page(max(0, min(MAX_POINTS, spare_points)))


def _context(contents: ReportContents) -> dict[str, Any]:
    """Return the variables of the template, except the clouds of the 3-D view."""
    document, explanation = contents.document, contents.explanation
    calibrated = len(contents.document.poses) > 1
    merged = {decision.chosen.names for decision in document.decisions if decision.chosen is not None}
    return {
        "contents": contents,
        "document": document,
        "explanation": explanation,
        "pair_figures": _pair_figures(contents, explanation.missing),
        "figures": rig_figures(contents, calibrated=calibrated),
        "calibrated": calibrated,
        "colours": {name: hex_colour(colour) for name, colour in contents.colours.items()},
        "label_colours": {
            "agree": hex_colour(AGREE),
            "lie in proven-empty space": hex_colour(VIOLATE),
            "occluded: no evidence": hex_colour(OCCLUDED),
        },
        "refused": refused_poses(contents),
        "points_total": sum(
            max(len(cloud), _points_of(document, name)) for name, cloud in contents.clouds.items() if len(cloud)
        ),
        "graph_size": _GRAPH_SIZE,
        "places": _graph_places(contents.document.lidars),
        "edges": [(pair, _edge(pair, merged=pair.names in merged)) for pair in document.pairs],
        "label_share": EDGE_LABEL_SHARE,
        "labelled": len(document.pairs) <= _MAX_LABELLED,
        "by_evidence": document.accepted_by == "evidence",
        "fitness_distance": f"{document.config.fine.fitness_distance_m:g}",
        "texts": extrinsics_texts(document),
        "rig": rig_drawing(contents),
        "matrix": {pair.key: pair for pair in document.pairs},
        "seconds": {stage: seconds for stage, seconds in document.timing_s.items() if seconds is not None},
        "config_toml": config_toml(document.config),
        "drive_maps": drive_maps(document, contents.shown_level),
        "map_size": SIZE_PX,
        "links_of": links_of(document),
    }


def _points_of(document: ResultDocument, lidar: str) -> int:
    """Return the number of points of a LiDAR after preprocessing, of its returns before that."""
    cleaned = None if document.stages is None else (document.stages.preprocess or {}).get(lidar)
    return document.input.lidars[lidar].points if cleaned is None else cleaned.points


def _pair_figures(contents: ReportContents, missing: Sequence[Missing]) -> dict[str, list[Figure]]:
    """Draw the decisive pair of each unplaced LiDAR, of a large rig only the first ones, each pair once."""
    first = {each.decisive.key: each.lidar for each in reversed(missing) if each.decisive is not None}
    shown = list(reversed(first.items()))[:_MAX_PICTURED]
    return {lidar: pair_figures(contents, pair) for pair, lidar in shown}


def opponents(missing: Missing) -> tuple[str, ...]:
    """Return the other LiDAR of the decisive pair, and the one that puts the unplaced LiDAR elsewhere, if any."""
    pairs = [pair for pair in (missing.decisive, missing.elsewhere) if pair is not None]
    others = tuple(name for pair in pairs for name in pair.key if name != missing.lidar)
    return others if missing.elsewhere else others[:1]


def _edge(pair: PairEntry, *, merged: bool) -> str:
    """Return what the graph shows of a pair, as words that are the classes of its line."""
    if merged and pair.verdict.outcome == "uncertain":
        return "merged uncertain"
    return "merged" if merged else pair.verdict.outcome


def _graph_places(names: Collection[str]) -> dict[str, tuple[float, float]]:
    """Return positions on an ellipse in name order."""
    (width, height), (across, down) = _GRAPH_SIZE, _GRAPH_RADII
    angles = [2.0 * math.pi * index / len(names) - 0.75 * math.pi for index in range(len(names))]
    places = [(width / 2.0 + across * math.cos(each), height / 2.0 + down * math.sin(each)) for each in angles]
    return {name: (round(x, 1), round(y, 1)) for name, (x, y) in zip(names, places, strict=True)}


class ExtrinsicsText(NamedTuple):
    """A text with its format: `key` for programs, `label` for people, `title` for what it holds."""

    key: str
    label: str
    title: str
    text: str


def extrinsics_texts(document: ResultDocument) -> list[ExtrinsicsText]:
    """Return `calibration.toml`, URDF and matrices as `multilica export` writes them; none without a placed LiDAR.

    URDF and matrices are in the base frame, if the run has one with x, y and yaw, else in the target's frame. They are
    left out if a name cannot stand in such files.
    """
    target, ground = document.target, document.ground
    poses = {name: pose for name, pose in document.poses.items() if document.lidars[name].placed and name != target}
    if not poses:
        return []
    extrinsics = Extrinsics(target, poses)
    if ground is not None and ground.T_base_target_rig is not None and not ground.doubt:
        extrinsics = extrinsics.seen_from(RigidTransform(ground.frame, target, np.asarray(ground.T_base_target)))
    texts = [ExtrinsicsText("toml", "TOML", "calibration.toml", calibration_toml(document))]
    if all(name.isprintable() and name == name.strip() != "" for name in extrinsics.members):
        inside = f"in the frame {extrinsics.target}"
        texts += [
            ExtrinsicsText("urdf", "URDF", f"URDF, fixed joints {inside}", urdf_text(extrinsics)),
            ExtrinsicsText("matrices", "matrices", f"4 x 4 matrices {inside}", matrix_text(extrinsics)),
        ]
    return texts


@cache
def _template() -> Template:
    filters = {
        "figure": lambda value, scale, digits: (
            "-" if value is None or math.isnan(value) else f"{scale * value:z.{digits}f}"
        ),
        "grouped": _grouped,
        "opponents": opponents,
        "sentences": _sentences,
        "short": partial(short_name, letters=_MAX_NAME),
        "snapshot_verdict": _snapshot_verdict,
        "times": lambda enlarged: "true to size" if enlarged == 1 else f"{enlarged:,} times enlarged",
        "with_code": _with_code,
    }
    script = own_text(_PACKAGE, "page_actions.js") + own_text(_PACKAGE, "rig_view.js")
    return page_template(_PACKAGE, own_text(_PACKAGE, "page.css"), script, filters)


def _grouped(groups: Sequence[Sequence[str]]) -> str:
    """Describe the groups after a merge step."""
    joined = [" + ".join(group) for group in groups if len(group) > 1]
    alone = [name for group in groups if len(group) == 1 for name in group]
    parts = [f"Joined: {', '.join(joined)}."] if joined else []
    parts += [f"Alone: {', '.join(alone)}."] if alone else []
    return " ".join(parts)


def _sentences(text: str) -> str:
    """Begin with a capital letter and end with a full stop."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}." if text else ""


def _snapshot_verdict(snapshot: SnapshotReport) -> str:
    verdicts = [f"Left out: {snapshot.refusal}"] if snapshot.refusal else []
    verdicts += [f"Outvoted on {lidar}" for lidar in snapshot.outliers]
    verdicts += [f"Contradicts others on {lidar} (undecided)" for lidar in snapshot.disputed]
    verdicts += [
        f"Differs from {' and '.join(each.contradicts)} on {each.lidar} by more than sigma allows"
        for each in snapshot.contradicting
    ]
    if not verdicts:
        verdicts = ["Agrees" if snapshot.deviations else snapshot.text]
    return " ".join(_sentences(verdict) for verdict in verdicts)


def _with_code(text: str) -> Markup:
    """Mark text between backticks as code."""
    parts = text.split("`")
    code = Markup("<code>{}</code>")
    return Markup("").join(code.format(part) if index % 2 else part for index, part in enumerate(parts))
