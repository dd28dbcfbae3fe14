# SPDX-License-Identifier: Apache-2.0
"""Recordings that end at any byte."""

from __future__ import annotations

import random

import pytest

from multilica.diagnosis import explain
from multilica.errors import UnreadableSourceError
from multilica.sinks.rerun.reading import read_recorded_document
from tests.selection import NIGHTLY, some_of


def stages_known(path) -> int | None:
    """Return None if the recording has no document."""
    try:
        document = read_recorded_document(path)
    except UnreadableSourceError:
        return None
    explanation = explain(document)
    assert explanation.headline
    return len(document.progress.finished)


@pytest.fixture(scope="module")
def known(recordings, tmp_path_factory):
    """Per share of the file that is left, how many stages it knows of; each is read in a process of its own."""
    whole = recordings["partial"].read_bytes()
    path = tmp_path_factory.mktemp("cut") / "cut.rrd"
    found = {}
    draw = random.Random(7)  # noqa: S311
    for share in sorted(some_of(sorted(draw.uniform(0.0, 1.0) for _ in range(40)), 6)):
        path.write_bytes(whole[: int(share * len(whole))])
        found[share] = stages_known(path)
    return found


@pytest.mark.slow
def test_what_is_known_never_shrinks_as_the_file_grows(known):
    counts = [-1 if count is None else count for count in known.values()]
    assert counts == sorted(counts)


@pytest.mark.slow
def test_most_cuts_leave_something_to_tell(known, recordings):
    known_counts = [count for count in known.values() if count is not None]
    assert len(known_counts) > len(known) // 2
    assert len(set(known_counts)) >= (4 if NIGHTLY else 3)
    assert stages_known(recordings["partial"]) == 10


@pytest.mark.slow
def test_junk_after_the_cut_is_refused_or_left_out(recordings, tmp_path):
    whole = recordings["partial"].read_bytes()
    path = tmp_path / "junk.rrd"
    path.write_bytes(whole[: len(whole) // 2] + random.Random(3).randbytes(5000))  # noqa: S311
    count = stages_known(path)
    assert count is None or 0 <= count <= 10
