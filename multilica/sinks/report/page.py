# SPDX-License-Identifier: Apache-2.0
"""HTML page of a report."""

import base64
import hashlib
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

from multilica.geometry import RigidTransform
from multilica.results import LEVEL_FRAME
from multilica.sinks.drawing.palette import AGREE, OCCLUDED, VIOLATE, distinct_colours, hex_colour
from multilica.sinks.files.toml_text import toml_text
from multilica.sinks.report.contents import ReportContents
from multilica.sinks.report.figures import Figure, pair_figures, rig_figures
from multilica.sinks.report.merge_graph import merge_graph
from multilica.sinks.report.outcome import Outcome, outcome_of
from multilica.sinks.report.rig_scene import BYTES_PER_POINT, MAX_POINTS, refused_poses, rig_scene
from multilica.sinks.report.tables import matrix_rows, pair_rows, result_rows, snapshot_rows, stage_rows

__all__ = ["MAX_BYTES", "report_html"]

MAX_BYTES = 8_000_000
"""Limit of ticket systems and mail; the clouds of the 3-D view are thinned until the page fits."""

_MAX_PICTURED = 4
_SLACK_BYTES = 20_000
"""Reserve for the text about thinning."""
_PACKAGE = "multilica.sinks.report"


def report_html(contents: ReportContents) -> str:
    """Render the report as one self-contained page of at most `MAX_BYTES` bytes."""
    frame = contents.level or RigidTransform.identity(LEVEL_FRAME, contents.target)
    colours = distinct_colours(contents.names)
    context = _context(contents, frame)

    def page(max_points: int) -> str:
        return _template().render(context | {"scene": rig_scene(contents, frame, colours, max_points)})

    whole = page(MAX_POINTS)
    if len(whole.encode()) <= MAX_BYTES:
        return whole
    spare_points = (MAX_BYTES - len(page(0).encode()) - _SLACK_BYTES) // BYTES_PER_POINT
    return page(max(0, min(MAX_POINTS, spare_points)))


def _context(contents: ReportContents, level: RigidTransform) -> dict[str, Any]:
    """Return the variables of the template, except the clouds of the 3-D view."""
    colours = distinct_colours(contents.names)
    outcome = outcome_of(contents)
    return {
        "contents": contents,
        "document": contents.document,
        "outcome": outcome,
        "pair_figures": _pair_figures(contents, outcome, level),
        "figures": rig_figures(contents, level, colours),
        "calibrated": len(contents.placed_poses()) > 1,
        "colours": {name: hex_colour(colour) for name, colour in colours.items()},
        "label_colours": {
            "agree": hex_colour(AGREE),
            "lie in proven-empty space": hex_colour(VIOLATE),
            "occluded: no evidence": hex_colour(OCCLUDED),
        },
        "refused": refused_poses(contents),
        "points_total": sum(len(cloud) for cloud in contents.clouds.values()),
        "graph": merge_graph(contents, colours),
        "result_rows": result_rows(contents),
        "matrix_rows": matrix_rows(contents),
        "pair_rows": pair_rows(contents),
        "snapshot_rows": snapshot_rows(contents),
        "stage_rows": stage_rows(contents),
        "config_toml": toml_text(contents.document.config.model_dump(mode="json")),
    }


def _pair_figures(contents: ReportContents, outcome: Outcome, level: RigidTransform) -> dict[str, list[Figure]]:
    """Draw the decisive pair of each unplaced LiDAR, of a large rig only the first ones, each pair once."""
    colours = distinct_colours(contents.names)
    first = {failure.pair: failure.missing.lidar for failure in reversed(outcome.failures) if failure.pair is not None}
    shown = [(pair, lidar) for pair, lidar in reversed(first.items()) if pair is not None][:_MAX_PICTURED]
    return {lidar: pair_figures(contents, pair, level, colours) for pair, lidar in shown}


@cache
def _template() -> Template:
    """Load the template with its style, its script, and their hashes for the content security policy."""
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
    """Mark text between backticks as code."""
    parts = text.split("`")
    code = Markup("<code>{}</code>")
    return Markup("").join(code.format(part) if index % 2 else part for index, part in enumerate(parts))


def _hash(text: str) -> str:
    """Return the hash of an inline script or style for the content security policy."""
    digest = hashlib.sha256(text.encode("utf-8")).digest()
    return f"sha256-{base64.b64encode(digest).decode('ascii')}"
