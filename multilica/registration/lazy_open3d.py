# SPDX-License-Identifier: Apache-2.0
"""Open3D, imported at the first use of one of its names."""

import sys
from functools import cache, partial
from importlib import import_module, reload
from types import ModuleType
from typing import Any

from multilica.optional_libraries import needed_for

_PLOTS = "open3d.visualization.draw_plotly"


class LazyOpen3d:
    """Open3D as a module that is imported at the first use of one of its names.

    That use raises MissingDependencyError if Open3D is not installed, or lacks a system library.

    Args:
        wanted: what needs it, as for `needed_for`.
    """

    def __init__(self, wanted: str) -> None:
        self._wanted = wanted

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - whatever Open3D has
        with needed_for(self._wanted, "open3d"):
            return getattr(_open3d(), name)


o3d = LazyOpen3d("The engine 'open3d'")


@cache
def _open3d() -> Any:  # noqa: ANN401 - a module
    """Import Open3D without Dash and Plotly, which take longer than the rest and only serve plots in a browser."""
    first = "open3d" not in sys.modules
    if first:
        sys.modules[_PLOTS] = _Deferred(_PLOTS)
    try:
        import open3d
    except OSError as error:  # releases before 0.20 load their libraries themselves
        raise ImportError(str(error)) from error
    finally:
        if first:
            del sys.modules[_PLOTS]
    return open3d


class _Deferred(ModuleType):
    """A module whose functions import the real one when they are called."""

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - whatever the real one has
        return partial(_plot, name)


def _plot(name: str, *arguments: object, **options: object) -> object:
    """Call a function of Open3D's plots, for whoever uses them in the same process."""
    return getattr(reload(import_module("open3d.visualization")), name)(*arguments, **options)
