# SPDX-License-Identifier: Apache-2.0
"""The recording is what its documentation says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.sinks.recording_reader import Recording

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "recording-layout.md").read_text(encoding="utf-8")
PART = r"(?:[^/\\]|\\.)+"
LIDAR_NAME = r"(?:front left/1|rear|top)"


def first_column(section: str) -> list[str]:
    """The code in the first cell of each row of a section's table."""
    text = PAGE.split(f"## {section}\n")[1].split("\n## ")[0]
    return re.findall(r"^\| `([^`]+)` \|", text, flags=re.MULTILINE)


def pattern(template: str, part: str) -> re.Pattern[str]:
    pieces = re.split(r"<\w+>", template)
    return re.compile(part.join(re.escape(piece) for piece in pieces))


@pytest.fixture(scope="module")
def recording(recordings):
    return Recording(recordings["complete"])


@pytest.fixture(scope="module")
def partial(recordings):
    """Some things are only there where a pair is refused."""
    return Recording(recordings["partial"])


@pytest.fixture(scope="module")
def drive(recordings):
    return Recording(recordings["drive"])


def test_recorded_and_documented_entities_agree(recording, partial, drive):
    entity_paths = recording.entity_paths | partial.entity_paths | drive.entity_paths
    patterns = {template: pattern(template, PART) for template in first_column("Entities")}
    undocumented = {path for path in entity_paths if not any(p.fullmatch(path) for p in patterns.values())}
    missing = {t for t, p in patterns.items() if not any(p.fullmatch(path) for path in entity_paths)}
    assert not undocumented
    assert not missing


def test_timelines_are_the_documented_ones(recording, drive):
    assert drive.timelines == set(first_column("Timelines"))
    assert recording.timelines == drive.timelines - {"stop"}


def test_recorded_and_documented_frames_agree(recording, partial, drive):
    frames = recording.frames | partial.frames | drive.frames
    patterns = {
        template: pattern(template, rf"(?:{LIDAR_NAME}|\d+|merged-\d+|stop_\d|before|implied|competing)")
        for template in first_column("Frames")
    }
    assert all(any(p.fullmatch(frame) for p in patterns.values()) for frame in frames)
    assert all(any(p.fullmatch(frame) for frame in frames) for p in patterns.values())


def test_properties_are_documented(recording):
    assert set(recording.properties()) == {"status", "version", "input_source", "input_sha256", "config"}
    for name in recording.properties():
        assert f"`{name}`" in PAGE
