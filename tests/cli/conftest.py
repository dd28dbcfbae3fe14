# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import pytest
import typer.main

from multilica import RigidTransform, read_snapshot
from multilica_cli.commands.calibrate import find_sample
from multilica_cli.main import run
from tests.cli.support import Invoke, Outcome, write_pcd, write_recording

built_once = cache(typer.main.get_command)
"""Typer builds all commands anew for each command line, which takes longer than most of them."""


@pytest.fixture
def invoke(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Invoke:
    """Runs a command line in a directory of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MULTILICA_DEBUG", raising=False)
    monkeypatch.setattr("typer.main.get_command", built_once)

    def call(*arguments: str | Path) -> Outcome:
        capsys.readouterr()
        code = run([str(argument) for argument in arguments])
        return Outcome(code, *capsys.readouterr())

    return call


@pytest.fixture(scope="session")
def snapshots(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with recordings of two LiDARs of the embedded sample.

    They are first, turned, second, alone, alone_too and other. The points of the left one are turned by 3 degrees in
    `turned`; `alone` and `alone_too` lack it, `other` has other names.
    """
    folder = tmp_path_factory.mktemp("snapshots")
    sample = read_snapshot(find_sample().recording)
    frames = [{name: sample[name].scans[index].points_m[::2] for name in ("left", "right")} for index in (0, 1)]
    turn = RigidTransform.from_xyz_rpy("left", "left", [0.0, 0.0, 0.0], [0.0, 0.0, math.radians(3.0)])
    write_recording(folder / "first.mcap", frames[0])
    write_recording(folder / "second.mcap", frames[1])
    write_recording(folder / "turned.mcap", {**frames[0], "left": turn.apply(frames[0]["left"])})
    write_recording(folder / "alone.mcap", {"right": frames[0]["right"]})
    write_recording(folder / "alone_too.mcap", {"right": frames[1]["right"]})
    write_recording(folder / "other.mcap", {"top": frames[0]["left"], "rear": frames[0]["right"]})
    return folder


@pytest.fixture(scope="session")
def two_lidars(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with left.pcd and right.pcd: a frame of two LiDARs of the embedded sample."""
    folder = tmp_path_factory.mktemp("scans") / "street"
    snapshot = read_snapshot(find_sample().recording)
    for name in ("left", "right"):
        write_pcd(folder / f"{name}.pcd", snapshot[name].scans[0].points_m)
    return folder
