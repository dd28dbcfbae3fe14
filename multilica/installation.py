# SPDX-License-Identifier: Apache-2.0
"""The state of an installation: libraries, viewer, machine, and the commands that repair missing parts."""

import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Literal

import multilica
from multilica.errors import escape_controls
from multilica.optional_libraries import OPTIONAL_LIBRARIES, ROS2, OptionalLibrary
from multilica.system_libraries import (
    SOFTWARE_DRIVER,
    apt_command,
    missing_for_open3d,
    missing_for_pictures,
    vulkan_drivers,
)

CORE_LIBRARIES: Mapping[str, str] = {
    "apsw": "apsw",
    "defusedxml": "defusedxml",
    "foxglove-schemas-protobuf": "foxglove_schemas_protobuf",
    "isal": "isal.isal_zlib",
    "jinja2": "jinja2",
    "lz4": "lz4.frame",
    "mcap": "mcap",
    "mcap-protobuf-support": "mcap_protobuf",
    "numpy": "numpy",
    "pillow": "PIL._imaging",
    "protobuf": "google.protobuf.message",
    "pyarrow": "pyarrow",
    "pybase64": "pybase64",
    "pydantic": "pydantic_core",
    "python-neo-lzf": "lzf",
    "rerun-sdk": "rerun_bindings",
    "rich": "rich",
    "rosbags": "rosbags",
    "ruamel.yaml": "ruamel.yaml",
    "scipy": "scipy.spatial",
    "small-gicp": "small_gicp",
    "threadpoolctl": "threadpoolctl",
    "tomli-w": "tomli_w",
    "typer": "typer",
    "typing-extensions": "typing_extensions",
    "zstandard": "zstandard",
}
"""Needed by every calibration: name in the package index -> the part whose import takes least time and shows that the
library can be loaded.
"""

State = Literal["works", "missing", "broken"]

_COMPILED = ("duckdb", "kiss_matcher", "lazrs", "teaserpp_python")
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_RENDERERS = ("/dev/dri/renderD*", "/dev/nvidia[0-9]*")
_PROBE_S = 30.0
# Another process, as a library that does not fit may end it. The import of all of Open3D takes a second, and what
# fails is the loading of these files.
_PROBE = """
import ctypes, json, sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
failures = {}
for name in sys.argv[1:]:
    print(json.dumps([name, "it ends the process"]), flush=True)
    try:
        if name == "open3d":
            folder = Path(find_spec(name).origin).parent
            for file in [*folder.glob("libOpen3D.*"), *folder.glob("**/pybind*.so")]:
                ctypes.CDLL(str(file))
        else:
            import_module(name)
        print(json.dumps([name, ""]), flush=True)
    except Exception as error:
        print(json.dumps([name, str(error) or type(error).__name__]), flush=True)
"""


@dataclass(frozen=True, slots=True)
class Library:
    """A library with its state.

    Args:
        name: in the package index.
        version: empty if it is missing.
        problem: why it is broken; empty if it is not.
        extra: the extra that installs it; empty if it is part of the core, or no extra has it.
        purpose: what works with it only.
        command: repairs it; empty if it works.
    """

    name: str
    state: State
    version: str = ""
    problem: str = ""
    extra: str = ""
    purpose: str = ""
    command: str = ""


@dataclass(frozen=True, slots=True)
class Viewer:
    """Abilities of `multilica view` on this machine.

    Args:
        screen: whether a window can be opened.
        drivers: Vulkan drivers that are installed.
        renderer: of pictures; none if a driver or the loader is missing.
        command: installs what pictures need; empty if nothing is missing.
    """

    screen: bool
    drivers: tuple[str, ...]
    renderer: Literal["GPU", "software", "none"]
    command: str


@dataclass(frozen=True, slots=True)
class Machine:
    """Facts about the machine.

    Args:
        cores: that this process may use.
        threads: the variables that limit the threads of libraries, as far as they are set.
        free_bytes: of the disks that take results and scratch files, by folder.
    """

    cores: int
    threads: Mapping[str, str]
    free_bytes: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class Installation:
    """The state of an installation."""

    multilica: str
    python: str
    platform: str
    core: tuple[Library, ...]
    optional: tuple[Library, ...]
    viewer: Viewer
    machine: Machine

    @property
    def works(self) -> bool:
        """True if the core is complete."""
        return all(library.state == "works" for library in self.core)

    @property
    def commands(self) -> tuple[str, ...]:
        """The commands that install or repair everything that is missing."""
        libraries = [library for library in (*self.core, *self.optional) if library.state != "works"]
        extras = {each.extra for each in libraries if each.extra and each.state == "missing"}
        every = {library.extra for library in OPTIONAL_LIBRARIES.values() if library.extra} - {ROS2}
        named = ["all", *sorted(extras - every)] if every <= extras else sorted(extras)
        joined = [f"pip install 'multilica[{','.join(named)}]'"] if extras else []
        single = [each.command for each in libraries if not (each.extra and each.state == "missing")]
        return tuple(dict.fromkeys(filter(None, [*joined, *single, self.viewer.command])))


def examine_installation() -> Installation:
    """Look at the installation in about a second; what is found is tried, in a process of its own."""
    core = [OptionalLibrary(module, (name,), "", "", f"pip install {name}") for name, module in CORE_LIBRARIES.items()]
    core += [library for library in OPTIONAL_LIBRARIES.values() if library.core]
    optional = [library for library in OPTIONAL_LIBRARIES.values() if not library.core]
    # A sourced ROS 2 has the name of the module, and none of PyPI.
    versions = {each.module: _version((*each.distributions, each.module)) for each in (*core, *optional)}
    tried = [module for module in (*(library.module for library in core), *_COMPILED) if versions[module]]
    problems = _problems(tried)
    examined_core, examined_optional = (
        tuple(_examined(each, versions[each.module], problems.get(each.module, "")) for each in libraries)
        for libraries in (core, optional)
    )
    folders = dict.fromkeys((str(Path.cwd()), tempfile.gettempdir()))
    return Installation(
        multilica.__version__,
        platform.python_version(),
        platform.platform(),
        examined_core,
        examined_optional,
        _viewer(),
        Machine(
            len(os.sched_getaffinity(0)),
            {name: os.environ[name] for name in _THREADS if name in os.environ},
            {folder: shutil.disk_usage(folder).free for folder in folders},
        ),
    )


def _version(distributions: Collection[str]) -> str:
    for name in distributions:
        try:
            return metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return ""


def _problems(modules: Sequence[str]) -> dict[str, str]:
    """Import modules in another process, or several if one ends it, and return what went wrong with each."""
    told: dict[str, str] = {}
    while untold := [module for module in modules if module not in told]:
        command = [sys.executable, "-c", _PROBE, *untold]
        try:
            output = subprocess.run(command, capture_output=True, timeout=_PROBE_S, check=False).stdout  # noqa: S603
        except subprocess.TimeoutExpired as late:
            output = late.stdout or b""
        answers = dict(json.loads(line) for line in output.splitlines() if line.startswith(b'["'))
        told |= answers or dict.fromkeys(untold, "Python does not start")
    return {module: escape_controls(problem) for module, problem in told.items() if problem}


def _examined(library: OptionalLibrary, version: str, problem: str) -> Library:
    state: State = "broken" if problem else "works" if version else "missing"
    mend = "" if version else library.install_command
    if problem:
        packages = missing_for_open3d() if library.module == "open3d" else []
        installed = next(name for name in library.distributions if _version((name,)))
        mend = apt_command(packages) if packages else f"pip install --force-reinstall {installed}"
    return Library(library.distributions[-1], state, version, problem, library.extra, library.purpose, mend)


def _viewer() -> Viewer:
    drivers, packages = tuple(vulkan_drivers()), missing_for_pictures()
    has_gpu = any(any(Path("/").glob(pattern[1:])) for pattern in _RENDERERS)
    renderer: Literal["GPU", "software"] = "GPU" if has_gpu and {*drivers} - {SOFTWARE_DRIVER} else "software"
    return Viewer(
        sys.platform != "linux" or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY"))),
        drivers,
        "none" if packages else renderer,
        apt_command(packages) if packages else "",
    )
