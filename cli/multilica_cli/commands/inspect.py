# SPDX-License-Identifier: Apache-2.0
"""`multilica inspect`: contents of a recording."""

from multilica.errors import UnfitSnapshotError
from multilica_cli.configuration import ingest_options, resolve_config
from multilica_cli.options import Frames, Json, Sources, Start, Strict, Topics, Window, WindowSeconds
from multilica_cli.terminal import print_json, stdout_console

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
    """List the topics of a recording and what calibrate would use."""
    from multilica.ingest import frames_recorded, inspect_source
    from multilica.ingest.locate import locate
    from multilica_cli.tables.source import print_summary, summary_document

    files = [locate(source) for source in sources]
    options = ingest_options(topics, frames, start, window, window_s, strict=strict)
    config = resolve_config(None, None, options, (), frames_recorded(files))
    summary = inspect_source(files, config=config.ingest)
    if as_json:
        print_json(summary_document(summary))
    else:
        print_summary(summary, stdout_console())
    if summary.objection:
        raise UnfitSnapshotError(summary.objection)
