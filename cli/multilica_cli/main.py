# SPDX-License-Identifier: Apache-2.0
"""Command `multilica`."""

from collections.abc import Sequence
from typing import Annotated

import typer

import multilica
from multilica_cli.commands.calibrate import calibrate, demo
from multilica_cli.commands.check import accept, check, verify
from multilica_cli.commands.config import config
from multilica_cli.commands.doctor import doctor
from multilica_cli.commands.evaluate import datasets, evaluate
from multilica_cli.commands.fleet import fleet
from multilica_cli.commands.publish import publish
from multilica_cli.commands.recordings import inspect, record
from multilica_cli.commands.saved_runs import diff, explain, export, query, report, view
from multilica_cli.commands.simulate import simulate
from multilica_cli.commands.watch import watch
from multilica_cli.exit_codes import print_failure
from multilica_cli.options import App
from multilica_cli.signals import Interrupted, received

app = App(
    name="multilica",
    no_args_is_help=True,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Exit codes: 0 all LiDARs placed; 1 system error or bug; 2 wrong usage; 3 unusable input; "
    "4 a LiDAR uncertain, not placed, silent or undecided, or a log without a result (fleet run); "
    "5 runs differ (diff), or a LiDAR is outside its tolerance (check, verify) or has moved (fleet drift); "
    "130 Ctrl-C; 143 SIGTERM; 129 SIGHUP.",
)
_commands = (calibrate, check, verify, watch, accept, inspect, record, explain, query, diff, view, report, config)
for command in (*_commands, simulate, evaluate, export, publish, datasets, demo, doctor):
    app.command()(command)
app.add_typer(fleet)


def run(arguments: Sequence[str] | None = None) -> int:
    """Run one command line, without the program's name, or that of the process, and return its exit code."""
    try:
        return app(arguments, standalone_mode=False) or 0
    except SystemExit:
        raise
    except BaseException as failure:  # noqa: BLE001
        return print_failure(failure if isinstance(failure, Interrupted) else received() or failure)


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"multilica {multilica.__version__}")
        raise typer.Exit


@app.callback()
def multilica_command(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Calibrate the extrinsics of a vehicle's LiDARs from one stationary snapshot."""
    del version
