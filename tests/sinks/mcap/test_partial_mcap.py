# SPDX-License-Identifier: Apache-2.0
"""MCAP files of runs that have not ended."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.highlevel import AnyReader

from multilica import events
from multilica.errors import UnreadableSourceError
from multilica.sinks.mcap.messages import read_attached_document
from multilica.sinks.mcap.result_mcap import ResultMcap
from tests.sinks.made_events import made_events


@pytest.mark.parametrize("encoding", ["foxglove", "ros2"])
def test_the_file_of_a_run_is_whole_after_each_long_stage(tmp_path, encoding):
    path = tmp_path / "result.mcap"
    seen = []
    with ResultMcap(path, encoding) as observe:
        for event in made_events():
            observe(event)
            if isinstance(event, events.StageFinished):
                finished = read_attached_document(tmp_path / "result.partial.mcap").progress.finished
                with (tmp_path / "result.partial.mcap").open("rb") as file:
                    reader = make_reader(file, validate_crcs=True)
                    summary = reader.get_summary()
                    assert len(list(reader.iter_messages())) == summary.statistics.message_count
                    assert {chunk.compression for chunk in summary.chunk_indexes} == {""}
                seen.append((event.stage, finished[-1]))
    assert [stage for stage, known in seen if stage == known] == ["ingest", "preprocess", "features", "fine"]
    assert [one.name for one in tmp_path.iterdir()] == ["result.mcap"]


def test_a_run_that_ends_early_leaves_its_state_and_cause(tmp_path):
    def end_early():
        with ResultMcap(tmp_path / "result.mcap", "ros2") as observe:
            for event in list(made_events())[:-1]:
                observe(event)
            raise ValueError("out of luck")

    with pytest.raises(ValueError, match="out of luck"):
        end_early()
    assert [one.name for one in tmp_path.iterdir()] == ["result.partial.mcap"]
    with AnyReader([tmp_path / "result.partial.mcap"]) as reader:
        found = [(one.topic, reader.deserialize(raw, one.msgtype)) for one, _, raw in reader.messages()]
    lines = [message.msg for topic, message in found if topic == "/log"]
    assert lines[-1] == "the run ended early: ValueError: out of luck"
    assert json.loads(next(one.data for topic, one in found if topic == "/metrics"))["status"] == "unfinished"


def test_nothing_is_written_of_a_run_that_never_started(tmp_path):
    with ResultMcap(tmp_path / "result.mcap"):
        pass
    assert list(tmp_path.iterdir()) == []


def cut_off(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-40])


def of_something_else(path: Path) -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.finish()


def no_mcap(path: Path) -> None:
    path.write_bytes(b"no mcap" * 100)


def empty(path: Path) -> None:
    path.write_bytes(b"")


@pytest.mark.parametrize("damage", [cut_off, of_something_else, no_mcap, empty])
def test_what_tells_of_no_run_is_refused_by_name(tmp_path, damage):
    path = tmp_path / "result.mcap"
    with ResultMcap(path) as observe:
        for event in made_events():
            observe(event)
    damage(path)
    with pytest.raises(UnreadableSourceError, match=str(path)):
        read_attached_document(path)
