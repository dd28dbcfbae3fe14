# SPDX-License-Identifier: Apache-2.0
"""Libraries imported when used: their table is that of the package, and what is missing is told in one sentence."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from multilica import optional_libraries
from multilica.errors import MissingDependencyError
from multilica.installation import CORE_LIBRARIES
from multilica.optional_libraries import OPTIONAL_LIBRARIES, ROS2, needed_for, require_library

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
LIBGL = "libGL.so.1: cannot open shared object file: No such file or directory"


def names(requirements: list[str]) -> set[str]:
    return {re.match(r"[\w.-]+", requirement)[0] for requirement in requirements} - {"multilica"}


def test_the_core_is_that_of_the_package() -> None:
    used_late = {name for library in OPTIONAL_LIBRARIES.values() if library.core for name in library.distributions}
    assert used_late == {"open3d", "open3d-cpu", "networkx"}
    assert {*CORE_LIBRARIES} | used_late == names(PROJECT["dependencies"])


def test_each_machine_gets_one_open3d() -> None:
    wanted = [Requirement(text) for text in PROJECT["dependencies"] if text.startswith("open3d")]
    for system, machine, name in (("Linux", "x86_64", "open3d-cpu"), ("Linux", "aarch64", "open3d")):
        here = {"platform_system": system, "platform_machine": machine}
        assert [each.name for each in wanted if each.marker.evaluate(here)] == [name]


def test_each_library_is_in_its_extra() -> None:
    found: dict[str, set[str]] = {}
    for library in OPTIONAL_LIBRARIES.values():
        if library.extra:
            found.setdefault(library.extra, set()).update(library.distributions)
        else:
            assert library.command
    # The client needs the other wheels of the extra, and a sourced ROS 2 has none of them.
    assert found.pop(ROS2) < names(EXTRAS[ROS2])
    assert found == {extra: names(required) for extra, required in EXTRAS.items() if extra not in ("all", ROS2)}


def test_the_extra_all_has_every_other_but_ros2() -> None:
    assert EXTRAS["all"] == [f"multilica[{','.join(sorted({*EXTRAS} - {'all', ROS2}))}]"]


@pytest.mark.parametrize("module", OPTIONAL_LIBRARIES)
def test_a_missing_library_is_one_sentence(module: str) -> None:
    with pytest.raises(MissingDependencyError) as caught, needed_for("Reading a.las", module, "wait"):
        raise ModuleNotFoundError(f"No module named '{module}'", name=module)
    command = OPTIONAL_LIBRARIES[module].install_command
    assert str(caught.value) == (
        f"Reading a.las needs the library {module}, which is not installed; `{command}` installs it, or wait."
    )


def test_a_library_that_is_not_found_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    require_library("Reading a.las", "laspy")
    monkeypatch.setattr(optional_libraries, "find_spec", lambda _: None)
    with pytest.raises(MissingDependencyError, match=r"needs the library laspy, .*'multilica\[las\]'` installs it\.$"):
        require_library("Reading a.las", "laspy")


def test_a_missing_system_library_names_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("multilica.system_libraries.loads", lambda library: library != "libGL.so.1")
    with pytest.raises(MissingDependencyError) as caught, needed_for("A simulation", "open3d"):
        raise ImportError(LIBGL)
    assert str(caught.value) == (
        f"A simulation needs the library open3d, which cannot be loaded ({LIBGL}); on Debian and Ubuntu `sudo apt-get "
        "install libgl1` installs what it lacks."
    )


def test_a_broken_library_is_to_be_installed_again() -> None:
    told = r"laspy, which cannot be loaded \(no name x\); `pip install --force-reinstall laspy` repairs it"
    with pytest.raises(MissingDependencyError, match=told), needed_for("Reading a.las", "laspy"):
        raise ImportError("no name x")


def test_a_lack_of_memory_stays_what_it_is() -> None:
    with pytest.raises(ImportError, match="failed to map segment"), needed_for("A simulation", "open3d"):
        raise ImportError("libOpen3D.so: failed to map segment from shared object")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ImportError", "OSError"])
def test_open3d_without_libgl_names_the_command(kind: str, tmp_path: Path) -> None:
    (tmp_path / "open3d").mkdir()
    (tmp_path / "open3d" / "__init__.py").write_text(f"raise {kind}({LIBGL!r})")
    code = "from multilica.simulate import simulate_snapshot; simulate_snapshot('sides', 'garage', 1)"
    path = os.pathsep.join([str(tmp_path), *sys.path])
    ended = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    told = rf"MissingDependencyError: A simulation needs the library open3d, .*{LIBGL}.* `sudo apt-get install lib"
    assert re.search(told, ended.stderr.splitlines()[-1])


def test_pandas_is_left_out_of_pyarrow_alone(tmp_path: Path) -> None:
    (tmp_path / "pandas.py").write_text("__version__ = '3.0.0'\n", encoding="utf-8")
    code = (
        "import sys; from multilica.optional_libraries import is_found, leave_out_pandas; leave_out_pandas(); "
        "import pyarrow; pyarrow.array(['text']); assert 'pandas' not in sys.modules; "
        "assert is_found('pandas'); import pandas"
    )
    paths = os.pathsep.join([str(tmp_path), *sys.path])
    subprocess.run([sys.executable, "-c", code], check=True, env={**os.environ, "PYTHONPATH": paths})
