# SPDX-License-Identifier: Apache-2.0
"""Libraries that are imported when they are used: what each is for, and the command that installs it."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from typing import NoReturn

from multilica.errors import MissingDependencyError
from multilica.system_libraries import OPEN3D, apt_command, missing_for_open3d

CORE_COMMAND = "pip install multilica"
"""Installs what an installation without its requirements lacks."""


ROS2 = "ros2"
"""The extra that `all` leaves out: it is large, and restarts each Python of its environment to set library paths."""


@dataclass(frozen=True, slots=True)
class OptionalLibrary:
    """A library that the preset `default` works without.

    Args:
        module: the name that is imported.
        distributions: alternative names in the package index; one is installed.
        extra: the extra of multilica that installs it; empty if none does.
        purpose: what works with it only.
        command: installs it where no extra does; `CORE_COMMAND` for a requirement of the plain installation.
    """

    module: str
    distributions: tuple[str, ...]
    extra: str
    purpose: str
    command: str = ""

    @property
    def core(self) -> bool:
        """True if the plain installation has it."""
        return self.command == CORE_COMMAND

    @property
    def install_command(self) -> str:
        """The command that installs it."""
        return self.command or f"pip install 'multilica[{self.extra}]'"


_ALL = (
    OptionalLibrary(
        "open3d", ("open3d-cpu", "open3d"), "", "presets of the paper, simulate, engines open3d", CORE_COMMAND
    ),
    OptionalLibrary("networkx", ("networkx",), "", "solver maximum_clique of the presets of the paper", CORE_COMMAND),
    OptionalLibrary("kiss_matcher", ("kiss-matcher",), "kiss", "solver kiss_matcher (Python up to 3.12)"),
    OptionalLibrary("laspy", ("laspy",), "las", "LAS and LAZ files"),
    OptionalLibrary("lazrs", ("lazrs",), "las", "LAZ files"),
    OptionalLibrary("fsspec", ("fsspec",), "remote", "files at https://"),
    OptionalLibrary("aiohttp", ("aiohttp",), "remote", "files at https://"),
    OptionalLibrary("s3fs", ("s3fs",), "s3", "files at s3://"),
    OptionalLibrary("gcsfs", ("gcsfs",), "gcs", "files at gs://"),
    OptionalLibrary("websockets", ("websockets",), "live", "record from a running vehicle at ws://"),
    OptionalLibrary("rclpy", ("ros-jazzy-rclpy",), ROS2, "a running vehicle at ros2://, unless ROS 2 is sourced"),
    OptionalLibrary("duckdb", ("duckdb",), "fleet", "fleet"),
    OptionalLibrary("distributed", ("distributed",), "dask", "fleet run --scheduler"),
    OptionalLibrary("prometheus_client", ("prometheus-client",), "watch", "watch --metrics"),
    OptionalLibrary("velodyne_decoder", ("velodyne-decoder",), "velodyne", "packets of Velodyne"),
    OptionalLibrary("ouster.sdk", ("ouster-sdk",), "", "packets of Ouster", "pip install --no-deps 'ouster-sdk>=1.0'"),
    OptionalLibrary(
        "teaserpp_python",
        ("teaserpp-python",),
        "",
        "solver teaserpp, else maximum_clique",
        "pip install git+https://github.com/MIT-SPARK/TEASER-plusplus.git",
    ),
    OptionalLibrary("pandas", ("pandas",), "", "to_dataframe of a result", "pip install pandas"),
)
OPTIONAL_LIBRARIES = {library.module: library for library in _ALL}
"""By the name that is imported."""


def is_found(module: str) -> bool:
    """Return whether a library can be found, without importing it."""
    try:
        return find_spec(module) is not None
    except (ModuleNotFoundError, ValueError):  # no parent package, or a module without a spec
        return False


class _RefusingPandas:
    """A finder of modules that finds no pandas, wherever it may be."""

    @staticmethod
    def find_spec(name: str, *_: object) -> None:
        if name == "pandas":
            raise ModuleNotFoundError(name=name)


def leave_out_pandas() -> None:
    """Have pyarrow take pandas for missing in this process; it would import it with the first text of a recording.

    That takes longer than the recording. Only for processes of multilica: in others, conversions to pandas may be
    wanted. Nothing else is affected.
    """
    if "pandas" in sys.modules:
        return
    with suppress(ImportError):  # told by what needs pyarrow
        import pyarrow as pa

        sys.meta_path.insert(0, _RefusingPandas)
        try:
            pa.array([""])
        finally:
            sys.meta_path.remove(_RefusingPandas)


@contextmanager
def needed_for(wanted: str, module: str, instead: str = "") -> Iterator[None]:
    """Turn the ImportError of an optional library into one sentence.

    Args:
        wanted: what the user asked for, as the subject of the sentence: ``"Reading a.las"``.
        module: key of `OPTIONAL_LIBRARIES`.
        instead: what else the user may do, as an imperative.

    Raises:
        MissingDependencyError: the library is missing, or cannot be loaded.
    """
    try:
        yield
    except ImportError as error:
        raise_missing(wanted, module, error, instead)


def require_library(wanted: str, module: str, instead: str = "") -> None:
    """Raise MissingDependencyError, with arguments as for `needed_for`, if a library cannot be found."""
    if not is_found(module):
        raise_missing(wanted, module, None, instead)


def raise_missing(wanted: str, module: str, error: ImportError | None, instead: str = "") -> NoReturn:
    """Raise MissingDependencyError for an optional library that was not imported, with arguments as for `needed_for`.

    An out-of-memory error is raised unchanged.
    """
    library = OPTIONAL_LIBRARIES[module]
    missing = error.name if isinstance(error, ModuleNotFoundError) else None
    name, otherwise = missing or library.distributions[-1], f", or {instead}" if instead else ""
    if error is None or missing or not is_found(module):
        state, mend = "is not installed", f"`{library.install_command}` installs it"
    elif "failed to map segment" in str(error) or "llocate memory" in str(error):
        raise error
    elif module == "open3d" and "shared object" in str(error):
        command = apt_command(missing_for_open3d() or OPEN3D.values())
        state, mend = f"cannot be loaded ({error})", f"on Debian and Ubuntu `{command}` installs what it lacks"
    else:
        command = f"pip install --force-reinstall {name}"
        state, mend = f"cannot be loaded ({error})", f"`{command}` repairs it"
    raise MissingDependencyError(f"{wanted} needs the library {name}, which {state}; {mend}{otherwise}.") from error
