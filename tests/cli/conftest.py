# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import pytest

from multilica import read_snapshot
from multilica_cli.main import run
from multilica_cli.sample import find_sample
from tests.cli.support import Invoke, Outcome, write_pcd


@pytest.fixture
def invoke(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Invoke:
    """Runs a command line in a directory of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MULTILICA_DEBUG", raising=False)

    def call(*arguments: str | Path) -> Outcome:
        capsys.readouterr()
        code = run([str(argument) for argument in arguments])
        return Outcome(code, *capsys.readouterr())

    return call


@pytest.fixture(scope="session")
def two_lidars(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with left.pcd and right.pcd: a frame of two LiDARs of the embedded sample."""
    folder = tmp_path_factory.mktemp("scans") / "street"
    snapshot = read_snapshot(find_sample().recording)
    for name in ("left", "right"):
        write_pcd(folder / f"{name}.pcd", snapshot[name].scans[0].points_m)
    return folder
