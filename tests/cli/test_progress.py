# SPDX-License-Identifier: Apache-2.0
"""Bars of the stages on a terminal, also of those that run together."""

import io
import re
from collections.abc import Iterable

import pytest
from rich.console import Console

from multilica import events
from multilica.config import STAGES
from multilica_cli import progress
from tests.sinks.made_events import made_events

STOPS = (
    events.StopsProgressed("find stops", 1, 90),
    events.StopsProgressed("find stops", 90, 90),
    events.StopsProgressed("read stops", 1, 3),
    events.StopsProgressed("read stops", 3, 3),
)


def text_of(shown: Iterable[events.RunEvent], monkeypatch: pytest.MonkeyPatch, *, terminal: bool) -> str:
    written = io.StringIO()
    console = Console(file=written, force_terminal=terminal, width=120)
    monkeypatch.setattr(progress, "stderr_console", lambda **_: console)
    with progress.show_progress(quiet=False) as observe:
        for event in shown:
            observe(event)
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", written.getvalue())


def test_the_stops_of_a_log_have_bars(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = text_of([*STOPS, events.SnapshotStarted("stop_1"), *made_events()], monkeypatch, terminal=True)
    shown = re.findall(r"(\w+ stops) +\S+ +(\d+)/(\d+)", plain.partition("snapshot stop_1")[0])
    assert shown[-2:] == [("find stops", "90", "90"), ("read stops", "3", "3")]
    assert re.search(r"ground +\S+ +1/1", plain)


def test_a_pipe_tells_how_many_stops_are_read(monkeypatch: pytest.MonkeyPatch) -> None:
    assert text_of(STOPS, monkeypatch, terminal=False) == "read stops: 3\n"


def test_the_bar_of_each_stage_ends_full(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = text_of(made_events(), monkeypatch, terminal=True)
    shown = re.findall(r"(\w+) +\S+ +(\d+)/(\d+)", plain)[-len(STAGES) :]
    assert [stage for stage, *_ in shown] == list(STAGES)
    assert all(done == total for _, done, total in shown)
    counts = {stage: int(done) for stage, done, _ in shown}
    assert counts["correspond"] == counts["coarse"] == counts["verify"] == 3
