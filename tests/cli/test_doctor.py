# SPDX-License-Identifier: Apache-2.0
"""`multilica doctor` on installations that lack something."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from multilica import installation
from multilica.installation import CORE_LIBRARIES, examine_installation
from multilica.optional_libraries import OPTIONAL_LIBRARIES
from multilica_cli.exit_codes import ExitCode
from tests.cli.support import Invoke

PRESENT = "1.2.3"


@pytest.fixture
def versions(monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Versions of the libraries that are found; all of them, until a test takes one out."""
    found = dict.fromkeys(CORE_LIBRARIES, PRESENT)
    found |= dict.fromkeys((name for each in OPTIONAL_LIBRARIES.values() for name in each.distributions), PRESENT)
    monkeypatch.setattr(installation, "_version", lambda names: next((found[n] for n in names if n in found), ""))
    monkeypatch.setattr(installation, "_problems", lambda _: {})
    monkeypatch.setattr(installation, "vulkan_drivers", lambda: ["lvp_icd"])
    monkeypatch.setattr(installation, "missing_for_pictures", list)
    return found


@pytest.mark.usefixtures("versions")
def test_a_whole_installation_has_nothing_to_mend(invoke: Invoke) -> None:
    outcome = invoke("doctor")
    assert outcome.code == ExitCode.DONE
    assert outcome.out.rstrip().endswith("The core works.")
    count = len(CORE_LIBRARIES) + len({"open3d", "networkx"})
    assert f"Core: {count} of {count} libraries work" in outcome.out


def test_missing_extras_are_one_command(versions: dict[str, str], invoke: Invoke) -> None:
    for name in ("laspy", "lazrs", "duckdb"):
        del versions[name]
    outcome = invoke("doctor")
    assert outcome.code == ExitCode.DONE
    assert outcome.out.splitlines()[-1] == "  pip install 'multilica[fleet,las]'"
    assert [line.split()[:2] for line in outcome.out.splitlines() if line.split()[1:2] == ["missing"]] == [
        ["laspy", "missing"],
        ["lazrs", "missing"],
        ["duckdb", "missing"],
    ]


def test_without_any_extra_the_command_is_all(versions: dict[str, str]) -> None:
    for library in OPTIONAL_LIBRARIES.values():
        for name in library.distributions if library.extra else ():
            versions.pop(name, None)
    assert examine_installation().commands == ("pip install 'multilica[all,ros2]'",)


def test_a_missing_core_library_is_a_failure(versions: dict[str, str], invoke: Invoke) -> None:
    del versions["small-gicp"]
    outcome = invoke("doctor")
    assert outcome.code == ExitCode.BROKEN
    assert "small-gicp       missing" in outcome.out
    assert outcome.out.splitlines()[-3:] == [
        "A part of the core is missing or broken.",
        "To install or repair the other parts:",
        "  pip install small-gicp",
    ]


@pytest.mark.slow
def test_a_broken_library_is_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, invoke: Invoke) -> None:
    """A module in the place of a library fails in the process that tries it."""
    (tmp_path / "small_gicp.py").write_text("raise ImportError('it does\\n not fit')")
    (tmp_path / "pyarrow.py").write_text("import os; os._exit(3)")
    (tmp_path / "open3d").mkdir()
    for name in ("__init__.py", "libOpen3D.so.1"):
        (tmp_path / "open3d" / name).write_text("")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    document = json.loads(invoke("doctor", "--json").out)
    found = {each["name"]: each for each in document["core"]}
    assert not document["works"]
    assert (found["small-gicp"]["state"], found["small-gicp"]["problem"]) == ("broken", "it does\\x0a not fit")
    assert found["small-gicp"]["command"] == "pip install --force-reinstall small-gicp"
    assert (found["pyarrow"]["state"], found["pyarrow"]["problem"]) == ("broken", "it ends the process")
    assert found["numpy"]["state"] == "works"
    assert found["open3d"]["state"] == "broken"
    assert found["open3d"]["problem"].endswith("libOpen3D.so.1: file too short")
    assert found["open3d"]["command"].startswith("pip install --force-reinstall open3d")


def test_open3d_without_a_system_library(versions: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    assert versions
    monkeypatch.setattr(installation, "_problems", lambda _: {"open3d": "libGL.so.1: cannot open"})
    monkeypatch.setattr(installation, "missing_for_open3d", lambda: ["libgl1"])
    found = examine_installation()
    assert not found.works
    assert found.commands == ("sudo apt-get install libgl1",)


def test_a_small_installation_names_what_it_lacks(versions: dict[str, str], invoke: Invoke) -> None:
    for name in ("open3d", "open3d-cpu", "networkx"):
        del versions[name]
    outcome = invoke("doctor")
    assert outcome.code == ExitCode.BROKEN
    assert "open3d           missing     presets of the paper, simulate, engines open3d" in outcome.out
    assert "networkx         missing     solver maximum_clique of the presets of the paper" in outcome.out
    assert outcome.out.splitlines()[-1] == "  pip install multilica"


@pytest.mark.usefixtures("versions")
def test_pictures_need_a_driver(monkeypatch: pytest.MonkeyPatch, invoke: Invoke) -> None:
    monkeypatch.setattr(installation, "vulkan_drivers", list)
    monkeypatch.setattr(installation, "missing_for_pictures", lambda: ["libvulkan1", "mesa-vulkan-drivers"])
    outcome = invoke("doctor")
    assert outcome.code == ExitCode.DONE
    assert "none: view --png lacks a library; Vulkan drivers: none" in outcome.out
    assert outcome.out.splitlines()[-1] == "  sudo apt-get install libvulkan1 mesa-vulkan-drivers"


@pytest.mark.parametrize("missing", [(), ("scipy", "laspy", "pandas")])
def test_it_fits_eighty_columns(missing: tuple[str, ...], versions: dict[str, str], invoke: Invoke) -> None:
    for name in missing:
        del versions[name]
    lines = invoke("doctor").out.splitlines()
    commands = lines.index("To install or repair the other parts:") if missing else len(lines)
    assert max(map(len, lines[:commands])) <= 80


@pytest.mark.slow
def test_it_imports_nothing_that_takes_time() -> None:
    code = "import sys; from multilica_cli.main import run; run(['doctor']); print(' '.join(sys.modules))"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert {"numpy", "scipy", "rerun", "open3d", "pyarrow"} & {*ended.stdout.splitlines()[-1].split()} == set()
