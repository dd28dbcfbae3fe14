# SPDX-License-Identifier: Apache-2.0
"""Commands whose help shows no type where it says nothing."""

from collections.abc import Callable
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup


def _without_types(params: list[Any]) -> list[Any]:
    """Leave out the type of flags, which take no value, and of arguments, whose help tells what they are."""
    for param in params:
        if getattr(param, "is_flag", False):
            param.metavar = ""
        elif param.param_type_name == "argument":
            param.display_type_rich = _no_type
    return params


def _no_type(ctx: object) -> None:
    del ctx


class _Command(TyperCommand):
    def get_params(self, ctx: Any) -> list[Any]:  # noqa: ANN401 - a private type of typer
        """Return the parameters for parsing and for help."""
        return _without_types(super().get_params(ctx))


class _Group(TyperGroup):
    def get_params(self, ctx: Any) -> list[Any]:  # noqa: ANN401 - a private type of typer
        """Return the parameters for parsing and for help."""
        return _without_types(super().get_params(ctx))


class App(typer.Typer):
    """A command line, or a group of commands within one."""

    def __init__(self, **options: Any) -> None:  # noqa: ANN401 - those of typer
        super().__init__(cls=_Group, **options)

    def command(self, *names: Any, **options: Any) -> Callable[[Any], Any]:  # noqa: ANN401 - those of typer
        """Register a function as a command."""
        return super().command(*names, cls=_Command, **options)
