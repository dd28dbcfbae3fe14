# SPDX-License-Identifier: Apache-2.0
"""Bars of the stages on a terminal, also of those that run together."""

import io
import re

import pytest
from rich.console import Console

from multilica.config import STAGES
from multilica_cli import progress
from tests.sinks.made_events import made_events


def test_the_bar_of_each_stage_ends_full(monkeypatch: pytest.MonkeyPatch) -> None:
    written = io.StringIO()
    terminal = Console(file=written, force_terminal=True, width=120)
    monkeypatch.setattr(progress, "stderr_console", lambda **_: terminal)
    with progress.show_progress(quiet=False) as observe:
        for event in made_events():
            observe(event)
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", written.getvalue())
    shown = re.findall(r"(\w+) +\S+ +(\d+)/(\d+)", plain)[-len(STAGES) :]
    assert [stage for stage, *_ in shown] == list(STAGES)
    assert all(done == total for _, done, total in shown)
    counts = {stage: int(done) for stage, done, _ in shown}
    assert counts["correspond"] == counts["coarse"] == counts["verify"] == 3
