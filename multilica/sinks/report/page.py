# SPDX-License-Identifier: Apache-2.0
"""The page itself."""

from __future__ import annotations

import base64
import hashlib
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

from multilica.geometry import RigidTransform
from multilica.sinks.palette import AGREE, OCCLUDED, VIOLATE, distinct_colours
from multilica.sinks.report.contents import ReportContents
from multilica.sinks.report.figures import Figure, pair_figures, rig_figures
from multilica.sinks.report.level import LEVEL, level_pose
from multilica.sinks.report.merge_graph import merge_graph
from multilica.sinks.report.outcome import Outcome, outcome_of
from multilica.sinks.report.rig_scene import BYTES_PER_POINT, MAX_POINTS, hex_colour, refused_poses, rig_scene
from multilica.sinks.report.tables import matrix_rows, pair_rows, result_rows, snapshot_rows, stage_rows
from multilica.sinks.toml_text import toml_text

__all__ = ["MAX_BYTES", "report_html"]

MAX_BYTES = 8_000_000
"""What ticket systems and mail take; the clouds of the 3-D view are thinned until the page fits."""

_MAX_PICTURED = 4
_SLACK_BYTES = 20_000
"""For what the page says of the thinning itself."""
_PACKAGE = "multilica.sinks.report"


def report_html(contents: ReportContents) -> str:
    """The report as one page that needs nothing else, of at most `MAX_BYTES` bytes."""
    level = level_pose(contents)
    frame = level or RigidTransform.identity(LEVEL, contents.target)
    colours = distinct_colours(contents.names)
    context = _context(contents, frame, levelled=level is not None)

    def page(max_points: int) -> str:
        return _template().render(context | {"scene": rig_scene(contents, frame, colours, max_points)})

    whole = page(MAX_POINTS)
    if len(whole.encode()) <= MAX_BYTES:
        return whole
    spare_points = (MAX_BYTES - len(page(0).encode()) - _SLACK_BYTES) // BYTES_PER_POINT
    return page(max(0, min(MAX_POINTS, spare_points)))


def _context(contents: ReportContents, level: RigidTransform, *, levelled: bool) -> dict[str, Any]:
    """What the template shows, but for the clouds of the 3-D view."""
    colours = distinct_colours(contents.names)
    outcome = outcome_of(contents)
    return {
        "contents": contents,
        "document": contents.document,
        "outcome": outcome,
        "pair_figures": _pair_figures(contents, outcome, level),
        "figures": rig_figures(contents, level, colours),
        "levelled": levelled,
        "calibrated": len(contents.placed_poses()) > 1,
        "colours": {name: hex_colour(colour) for name, colour in colours.items()},
        "judged_colours": {
            "agree": hex_colour(AGREE),
            "stand in space that beams passed through": hex_colour(VIOLATE),
            "hidden, say nothing": hex_colour(OCCLUDED),
        },
        "refused": refused_poses(contents),
        "points_total": sum(len(cloud) for cloud in contents.clouds.values()),
        "graph": merge_graph(contents, colours),
        "result_rows": result_rows(contents),
        "matrix_rows": matrix_rows(contents),
        "pair_rows": pair_rows(contents),
        "snapshot_rows": snapshot_rows(contents),
        "stage_rows": stage_rows(contents),
        "config_toml": toml_text(contents.document["config"]),
    }


def _pair_figures(contents: ReportContents, outcome: Outcome, level: RigidTransform) -> dict[str, list[Figure]]:
    """Per LiDAR that is not placed, its decisive comparison; of a large rig the first ones only.

    A comparison that decides for several LiDARs is shown at the first of them.
    """
    colours = distinct_colours(contents.names)
    first = {failure.pair: failure.missing.lidar for failure in reversed(outcome.failures) if failure.pair is not None}
    shown = [(pair, lidar) for pair, lidar in reversed(first.items()) if pair is not None][:_MAX_PICTURED]
    return {lidar: pair_figures(contents, pair, level, colours) for pair, lidar in shown}


@cache
def _template() -> Template:
    """The page, with the style and the script that are ours and the hashes by which nothing else gets in."""
    environment = Environment(
        loader=PackageLoader(_PACKAGE, ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    own = {name: files(_PACKAGE).joinpath(name).read_text(encoding="utf-8") for name in ("page.css", "rig_view.js")}
    environment.filters["with_code"] = _with_code
    environment.globals |= {
        "style": Markup(own["page.css"]),  # noqa: S704
        "script": Markup(own["rig_view.js"]),  # noqa: S704
        "style_hash": _hash(own["page.css"]),
        "script_hash": _hash(own["rig_view.js"]),
    }
    return environment.get_template("page.html")


def _with_code(text: str) -> Markup:
    """A sentence in which commands stand between backticks."""
    parts = text.split("`")
    code = Markup("<code>{}</code>")
    return Markup("").join(code.format(part) if index % 2 else part for index, part in enumerate(parts))


def _hash(text: str) -> str:
    """As a content security policy names an inline script or style that may be used."""
    digest = hashlib.sha256(text.encode("utf-8")).digest()
    return f"sha256-{base64.b64encode(digest).decode('ascii')}"
