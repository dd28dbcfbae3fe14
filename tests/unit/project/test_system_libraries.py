# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from multilica import system_libraries

SCRIPT = Path(__file__).parents[3] / ".ci" / "system_libraries.py"


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script on a machine where nothing is missing, run by a user without rights."""
    spec = importlib.util.spec_from_file_location("system_libraries", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(system_libraries, "loads", bool)
    monkeypatch.setattr(module, "privilege", lambda: None)
    monkeypatch.setattr(module, "missing_for_pictures", list)
    monkeypatch.setattr(module, "missing_browser", list)
    monkeypatch.setattr(module, "missing_jq", list)
    monkeypatch.setattr(sys, "argv", [str(SCRIPT)])
    return module


def test_nothing_is_done_where_nothing_is_missing(script: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    script.main()
    assert capsys.readouterr().out == ""


def test_a_user_without_rights_reads_the_command(script: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system_libraries, "loads", lambda library: library not in {"libGL.so.1", "libusb-1.0.so.0"})
    with pytest.raises(SystemExit) as ended:
        script.main()
    assert str(ended.value).splitlines()[-1].strip() == "sudo apt-get install libusb-1.0-0 libgl1"


def test_a_missing_venv_module_is_a_package_too(script: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "ensurepip" else object())
    assert script.missing_packages() == [f"python{sys.version_info.major}.{sys.version_info.minor}-venv"]


@pytest.mark.parametrize("privilege", [[], ["sudo", "-n"]])
def test_what_is_missing_is_installed_with_apt(
    privilege: list[str], script: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    commands: list[list[str]] = []

    def record(command: list[str], **options: object) -> subprocess.CompletedProcess[bytes]:
        assert options["stdin"] == subprocess.DEVNULL
        commands.append(command)
        return subprocess.CompletedProcess(command, 0)

    monkeypatch.setattr(system_libraries, "loads", lambda library: library != "libEGL.so.1")
    monkeypatch.setattr(script, "privilege", lambda: privilege)
    monkeypatch.setattr(script.shutil, "which", lambda name: f"/usr/bin/{name}")
    monkeypatch.setattr(script.subprocess, "run", record)
    script.main()
    assert [command[: len(privilege)] for command in commands] == [privilege, privilege]
    assert commands[0][-1] == "update"
    assert commands[1][-4:] == ["install", "--yes", "--no-install-recommends", "libegl1"]


def test_missing_pictures_are_no_failure(
    script: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(script, "missing_for_pictures", lambda: ["libvulkan1"])
    monkeypatch.setattr(script, "missing_browser", lambda: ["chromium-headless-shell"])
    monkeypatch.setattr(script, "missing_jq", lambda: ["jq"])
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), "--pictures"])
    script.main()
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[-1] for line in lines] == ["libvulkan1", "chromium-headless-shell", "jq"]


def test_an_old_python_is_refused(script: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(script, "OLDEST_PYTHON", (99, 0))
    with pytest.raises(SystemExit, match="newer"):
        script.main()
