# SPDX-License-Identifier: Apache-2.0
"""`multilica fleet report`: a store as one HTML page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from multilica_cli import options
from multilica_cli.terminal import stdout_console


def report(
    *,
    store: options.FleetStore,
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="File to write.", callback=options.local_path)
    ] = Path("fleet-report.html"),
    quiet: options.Quiet = False,
) -> None:
    """Write one HTML page: LiDARs that moved, vehicles, failures by cause, and the pose of each LiDAR over time."""
    from multilica.fleet.report.store_report import store_report
    from multilica.fleet.store.store import open_store
    from multilica.sinks.files.atomic import write_text_atomically

    write_text_atomically(out, store_report(open_store(store, create=False), out))
    stdout_console(quiet=quiet).print(f"wrote {out}")
