# SPDX-License-Identifier: Apache-2.0
"""`multilica config`: every parameter with its meaning."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from multilica.errors import UsageError
from multilica_cli.configuration import resolve_config
from multilica_cli.options import ConfigFile, Preset, Settings
from multilica_cli.terminal import stdout_console

if TYPE_CHECKING:
    from multilica.config import CalibrationConfig
    from multilica_cli.parameters import Parameter

__all__ = ["config"]


def config(
    *,
    preset: Preset = None,
    config_file: ConfigFile = None,
    settings: Settings = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print it as JSON.")] = False,
    as_toml: Annotated[bool, typer.Option("--toml", help="Print it as a file that --config reads.")] = False,
    as_markdown: Annotated[
        bool, typer.Option("--markdown", help="Print it as the page docs/configuration.md.")
    ] = False,
) -> None:
    """Print every parameter with its value, unit and meaning."""
    if as_json + as_toml + as_markdown > 1:
        raise UsageError("Found more than one of --json, --toml and --markdown; give one of them.")
    from multilica_cli.parameters import configuration_file, configuration_page, parameters

    resolved = resolve_config(preset, config_file, {}, settings or ())
    if as_toml:
        typer.echo(configuration_file(resolved), nl=False)
    elif as_markdown:
        typer.echo(configuration_page(), nl=False)
    elif as_json:
        typer.echo(json.dumps([asdict(parameter) for parameter in parameters(resolved)], indent=2))
    else:
        _print_tables(resolved, parameters(resolved))


def _print_tables(resolved: CalibrationConfig, rows: tuple[Parameter, ...]) -> None:
    from rich import box
    from rich.table import Table

    from multilica_cli.inline_toml import inline_toml

    table = Table(title=f"preset {resolved.preset}", title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("key", no_wrap=True)
    table.add_column("value", overflow="fold")
    table.add_column("unit")
    table.add_column("meaning", ratio=1)
    for before, row in zip((None, *rows), rows, strict=False):
        if before is not None and before.section != row.section:
            table.add_section()
        allowed = f" ({row.allowed})" if row.allowed else ""
        table.add_row(row.key, inline_toml(row.value), row.unit, row.meaning + allowed)
    stdout_console().print(table)
