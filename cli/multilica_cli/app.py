# SPDX-License-Identifier: Apache-2.0
"""Commands whose help shows no type where it says nothing, and whose options may come in groups."""

import inspect
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from functools import wraps
from inspect import Parameter
from typing import Any, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup


def _without_types(params: list[Any]) -> list[Any]:
    """Leave out the type of flags, which take no value, and of arguments, whose help describes them."""
    for param in params:
        if getattr(param, "is_flag", False):
            param.metavar = ""
        elif param.param_type_name == "argument":
            param.display_type_rich = _no_type
    return params


def _no_type(ctx: object) -> None:
    del ctx


class _PlainHelp:
    def get_params(self, ctx: Any) -> list[Any]:  # noqa: ANN401 - a private type of typer
        """Return the parameters for parsing and for help."""
        return _without_types(super().get_params(ctx))  # type: ignore[misc]


class _Command(_PlainHelp, TyperCommand):
    pass


class _Group(_PlainHelp, TyperGroup):
    pass


class App(typer.Typer):
    """A command line, or a group of commands within one."""

    def __init__(self, **options: Any) -> None:  # noqa: ANN401 - those of typer
        super().__init__(cls=_Group, **options)

    def command(self, *names: Any, **options: Any) -> Callable[[Any], Any]:  # noqa: ANN401 - those of typer
        """Register a function as a command; a parameter that is a dataclass stands for an option per field."""
        register = super().command(*names, cls=_Command, **options)
        return lambda function: register(_with_groups(function))


def _with_groups(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function with the fields of its parameters that are dataclasses as parameters of their own."""
    signature = inspect.signature(function, eval_str=True)
    every = signature.parameters.items()
    groups: dict[str, Any] = {name: each.annotation for name, each in every if is_dataclass(each.annotation)}
    if not groups:
        return function

    @wraps(function)
    def with_fields(**values: Any) -> Any:  # noqa: ANN401 - those of the function
        for name, group in groups.items():
            values[name] = group(**{each.name: values.pop(each.name) for each in fields(group)})
        return function(**values)

    parameters: list[Parameter] = []
    for name, each in every:
        parameters += _fields_of(groups[name]) if name in groups else [each]
    with_fields.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return with_fields


def _fields_of(group: Any) -> list[Parameter]:  # noqa: ANN401 - a type of dataclass
    hints = get_type_hints(group, include_extras=True)
    return [
        Parameter(
            each.name,
            Parameter.KEYWORD_ONLY,
            default=Parameter.empty if each.default is MISSING else each.default,
            annotation=hints[each.name],
        )
        for each in fields(group)
    ]
