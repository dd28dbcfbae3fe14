# SPDX-License-Identifier: Apache-2.0
"""`multilica config`: list of all parameters."""

from dataclasses import asdict
from itertools import groupby
from typing import Annotated

import typer

from multilica.errors import UsageError
from multilica_cli.configuration import inline_toml, resolve_config
from multilica_cli.options import ConfigFile, Preset, Settings
from multilica_cli.terminal import print_json, stdout_console

__all__ = ["config"]


def config(
    *,
    preset: Preset = None,
    config_file: ConfigFile = None,
    settings: Settings = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    as_toml: Annotated[bool, typer.Option("--toml", help="Print a file for --config.")] = False,
    as_markdown: Annotated[bool, typer.Option("--markdown", help="Print the page docs/configuration.md.")] = False,
) -> None:
    """Print all parameters with value, unit and meaning."""
    from rich import box
    from rich.table import Table

    from multilica_cli.parameters import configuration_file, configuration_page, parameters

    if as_json + as_toml + as_markdown > 1:
        raise UsageError("Found more than one of --json, --toml and --markdown; give one of them.")
    resolved = resolve_config(preset, config_file, {}, settings or ())
    rows = parameters(resolved)
    if as_toml:
        typer.echo(configuration_file(resolved), nl=False)
        return
    if as_markdown:
        typer.echo(configuration_page(), nl=False)
        return
    if as_json:
        print_json([asdict(parameter) for parameter in rows])
        return
    table = Table(title=f"preset {resolved.preset}", title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("key", no_wrap=True)
    table.add_column("value", overflow="fold")
    table.add_column("unit")
    table.add_column("meaning", ratio=1)
    for _, section in groupby(rows, key=lambda row: row.section):
        for row in section:
            table.add_row(row.key, inline_toml(row.value), row.unit, row.meaning_with_limits)
        table.add_section()
    stdout_console().print(table)
