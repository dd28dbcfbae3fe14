# SPDX-License-Identifier: Apache-2.0
"""An output is a file on this machine."""

from __future__ import annotations

from pathlib import Path

import pytest

from multilica import run_calibration
from multilica.errors import UsageError
from multilica_cli.exit_codes import ExitCode
from tests.cli.support import Invoke, assert_one_sentence

OUTPUTS = [
    ("calibrate", "drive.mcap", "--out"),
    ("check", "run", "--against", "calibration.toml", "--out"),
    ("check", "run", "--against", "calibration.toml", "--junit"),
    ("check", "run", "--against", "calibration.toml", "--summary"),
    ("check", "run", "--against", "calibration.toml", "--code-quality"),
    ("verify", "drive.mcap", "--calibration", "calibration.toml", "--junit"),
    ("verify", "drive.mcap", "--calibration", "calibration.toml", "--summary"),
    ("verify", "drive.mcap", "--calibration", "calibration.toml", "--code-quality"),
    ("accept", "run", "--into"),
    ("record", "drive.mcap", "--out"),
    ("report", "run", "--out"),
    ("evaluate", "run", "--truth", "truth.toml", "--out"),
    ("view", "run", "--png"),
    ("export", "run", "--to", "csv", "--out"),
    ("simulate", "--rig", "sides", "--scene", "garage", "--out"),
    ("datasets", "opencalib", "data", "--out"),
    ("demo", "--out"),
]


@pytest.mark.parametrize("words", OUTPUTS, ids=lambda words: f"{words[0]} {words[-1]}")
def test_an_address_is_refused_before_any_work(invoke: Invoke, words: tuple[str, ...]) -> None:
    outcome = invoke(*words, "s3://user:secret@bucket/x.mcap")
    assert_one_sentence(outcome, ExitCode.USAGE)
    assert f"An output is a file on this machine; found {words[-1]} s3://" in outcome.err
    assert "secret" not in outcome.err
    assert not list(Path().iterdir())


def test_the_library_refuses_it_too() -> None:
    with pytest.raises(UsageError, match="found out gs://bucket/x"):
        run_calibration("drive.mcap", "gs://bucket/x")
