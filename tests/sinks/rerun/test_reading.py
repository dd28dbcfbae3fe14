# SPDX-License-Identifier: Apache-2.0
"""Clouds and documents read from recordings."""

from __future__ import annotations

import ctypes
import os
import resource
import subprocess
import sys

import numpy as np
import pytest
import rerun as rr

from multilica.errors import UnreadableSourceError
from multilica.sinks.rerun.reading import read_recorded_clouds, read_recorded_document, read_recorded_scores
from multilica.sinks.rerun.recording import RerunRecording
from multilica.sinks.rerun.scene import pair_path
from tests.sinks.made_events import LIDARS, made_events

LIMIT_BYTES = 8 << 30
_DROP_CAPABILITY, _OF_RESOURCES = 24, 24
"""Of prctl(2), and CAP_SYS_RESOURCE."""


@pytest.mark.slow
def test_clouds_and_document_are_read_back(recordings):
    document = read_recorded_document(recordings["partial"])
    assert document.status == "partial"
    assert document.timing_s == {}
    figures = document.stages.preprocess
    clouds = read_recorded_clouds(recordings["partial"], [*LIDARS, "nobody"])
    assert {name: len(points_m) for name, points_m in clouds.items()} == {
        **{lidar: figures[lidar].points for lidar in LIDARS},
        "nobody": 0,
    }


def test_raw_clouds_of_a_run_that_ended_early_are_read(tmp_path):
    started, *_ = made_events()
    with RerunRecording(tmp_path / "run.rrd") as observe:
        observe(started)
    clouds = read_recorded_clouds(tmp_path / "run.partial.rrd", LIDARS)
    assert {name: len(points_m) for name, points_m in clouds.items()} == {
        lidar.name: lidar.points_count for lidar in started.snapshot.lidars
    }


def test_a_pose_without_scored_points_keeps_its_place(tmp_path):
    labels = ([1, 2, 3], [], [2, 2, 1])
    with rr.RecordingStream("multilica") as stream:
        stream.save(tmp_path / "scored.rrd")
        for step, classes in enumerate(labels):
            stream.set_time("step", sequence=step)
            stream.log(pair_path("top", "rear", "scored", "source"), rr.Points3D.from_fields(class_ids=classes))
        stream.log(pair_path("top", "rear", "scored", "source"), rr.CoordinateFrame("lidar/rear"))
        stream.disconnect()
    scores = read_recorded_scores(tmp_path / "scored.rrd", [("top", "rear")])
    assert [each.tolist() for each in scores["top", "rear"].labels] == [*reversed(labels)]


def test_a_reader_that_crashes_is_told_in_one_sentence(recordings, monkeypatch):
    monkeypatch.setattr("multilica.sinks.rerun.rrd_process._COMMAND", "import os; os.abort()")
    with pytest.raises(UnreadableSourceError, match=r"is a damaged recording: Rerun's reader crashed on it"):
        read_recorded_document(recordings["partial"])


@pytest.mark.slow
@pytest.mark.in_turn
def test_damaged_recordings_are_read_or_refused(recordings, tmp_path):
    rng, whole = np.random.default_rng(0), recordings["partial"].read_bytes()
    refused = 0
    for number in range(8):
        damaged = bytearray(whole)
        damaged[int(rng.integers(len(whole)))] ^= 1 << int(rng.integers(8))
        path = tmp_path / f"{number}.rrd"
        path.write_bytes(damaged)
        try:
            assert read_recorded_document(path).target == "top"
        except UnreadableSourceError:
            refused += 1
    assert refused > 0


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_recording_is_read_under_a_limit_of_memory(recordings):
    """As of `ulimit -v`, which only a privileged process could raise."""
    code = "import sys; from pathlib import Path; from multilica.diagnosis import explain\n"
    code += "from multilica.runs.run_documents import read_run_document\n"
    code += "print(explain(read_run_document(Path(sys.argv[1])).document).headline)"
    ended = subprocess.run(
        [sys.executable, "-c", code, str(recordings["partial"])],
        preexec_fn=_limit_memory_for_good,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert ended.returncode == 0, ended.stderr


def _limit_memory_for_good() -> None:
    ctypes.CDLL(None).prctl(_DROP_CAPABILITY, _OF_RESOURCES, 0, 0, 0)
    resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, LIMIT_BYTES))
