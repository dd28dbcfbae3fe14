# SPDX-License-Identifier: Apache-2.0
"""`multilica inspect`: what a recording holds."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import typer

from multilica.errors import UnfitSnapshotError
from multilica_cli.configuration import ingest_options, resolve_config
from multilica_cli.options import Frames, Json, Sources, Start, Strict, Topics, Window, WindowSeconds
from multilica_cli.terminal import stdout_console

if TYPE_CHECKING:
    from multilica.ingest import SourceSummary

__all__ = ["inspect"]


def inspect(
    sources: Sources,
    *,
    topics: Topics = None,
    frames: Frames = None,
    start: Start = None,
    window: Window = None,
    window_s: WindowSeconds = None,
    strict: Strict = False,
    as_json: Json = False,
) -> None:
    """Print what a recording holds, and what calibrate would take from it."""
    from multilica.ingest import frames_recorded, inspect_source
    from multilica.ingest.source import locate
    from multilica_cli.source_tables import print_summary, summary_document

    files = [locate(source) for source in sources]
    options = ingest_options(topics, frames, start, window, window_s, strict=strict)
    config = resolve_config(None, None, options, (), frames_recorded(files))
    summary = inspect_source(files, config=config.ingest)
    if as_json:
        typer.echo(json.dumps(summary_document(summary), indent=2))
    else:
        print_summary(summary, stdout_console())
    _require_fit(summary)


def _require_fit(summary: SourceSummary) -> None:
    if summary.objection:
        raise UnfitSnapshotError(summary.objection)
