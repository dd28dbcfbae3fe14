# SPDX-License-Identifier: Apache-2.0
"""`multilica query`."""

from __future__ import annotations

import csv
import io
import json

import pyarrow.parquet as pq
import pytest

from multilica.sinks.rerun.recording import RerunRecording
from tests.runs.made_runs import write_run
from tests.selection import some_of
from tests.sinks.conftest import record
from tests.sinks.made_events import made_events

_PAIRS = [("rear", "front left/1"), ("front left/1", "top"), ("rear", "top")]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    record(folder / "recording.rrd", "partial")
    return folder


@pytest.fixture(scope="module")
def joint(tmp_path_factory):
    """A run of several snapshots, whose recording has no pairs of its own."""
    folder = write_run(tmp_path_factory.mktemp("joint") / "run", {"left": None})
    document = json.loads((folder / "result.json").read_text())
    document["snapshots"] = [{"name": "stop_1", "source": "drive.mcap", "sha256": ""}]
    (folder / "result.json").write_text(json.dumps(document))
    (folder / "stop_1").mkdir()
    with RerunRecording(folder / "recording.rrd") as observe:
        for event in list(made_events())[:8]:
            observe(event)
    return folder


def _objects(done):
    return [json.loads(line) for line in done.out.splitlines()]


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize("table", some_of(["pairs", "matches", "surfaces", "merge", "timings"], 1))
def test_all_forms_have_the_same_rows(invoke, run, tmp_path, table):
    done = invoke("query", run / "recording.rrd", table)
    assert done.code == 0
    by_csv = list(csv.DictReader(io.StringIO(done.out)))
    by_json = [
        json.loads(line) for line in invoke("query", run / "recording.rrd", table, "--format", "json").out.splitlines()
    ]
    path = tmp_path / "deep" / "table.parquet"
    assert invoke("query", run / "recording.rrd", table, "--format", "parquet", "--out", path).code == 0
    by_parquet = pq.read_table(path).to_pylist()
    assert len(by_csv) == len(by_json) == len(by_parquet) > 0
    assert list(by_csv[0]) == list(by_json[0]) == list(by_parquet[0])
    for texts, values in zip(by_csv, by_json, strict=True):
        assert texts == {name: "" if value is None else str(value) for name, value in values.items()}


@pytest.mark.slow
def test_pairs_have_their_figures_and_reasons(invoke, run):
    rows = [
        json.loads(line)
        for line in invoke("query", run / "recording.rrd", "pairs", "--format", "json").out.splitlines()
    ]
    assert [(row["target"], row["source"]) for row in rows] == _PAIRS
    assert rows[2]["reasons"] == "too_little_evidence,ambiguous,not_observable"
    assert rows[2]["sigma_m"] is None


@pytest.mark.slow
def test_the_rows_go_to_a_file(invoke, run, tmp_path):
    done = invoke("query", run / "recording.rrd", "merge", "--out", tmp_path / "merge.csv")
    assert (done.code, done.out) == (0, "")
    assert (tmp_path / "merge.csv").read_text() == invoke("query", run / "recording.rrd", "merge").out
    assert invoke("query", run / "recording.rrd", "merge", "--out", tmp_path / "merge.parquet").code == 0
    assert (tmp_path / "merge.parquet").read_bytes().startswith(b"PAR1")


@pytest.mark.parametrize("table", ["matches", "surfaces", "merge"])
def test_a_joint_run_names_the_run_of_a_snapshot(invoke, joint, table):
    done = invoke("query", joint, table)
    assert (done.code, len(done.out.splitlines())) == (0, 1)
    assert done.out.startswith("merge_step," if table == "merge" else "target,source,")
    part = f"multilica query {joint}/stop_1 {table}"
    assert part in " ".join(done.err.split())


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("pairs", "--format", "parquet"), 2, "--format parquet needs a file; add --out FILE."),
        (("poses",), 2, "'poses' is not one of 'pairs', 'matches', 'surfaces', 'merge', 'timings'"),
        (("pairs", "--out", "s3://bucket/pairs.csv"), 2, "s3://bucket/pairs.csv"),
        (("pairs", "--format", "csv", "--out", "pairs.parquet"), 2, "--format csv and the name pairs.parquet"),
    ],
    ids=["parquet", "table", "address", "two forms"],
)
def test_a_wrong_use_is_told(invoke, run, arguments, code, said):
    done = invoke("query", run / "recording.rrd", *arguments)
    assert done.code == code
    assert said in done.err
    assert done.out == ""


@pytest.mark.slow
def test_a_run_without_a_recording_is_told(invoke, tmp_path):
    (tmp_path / "empty").mkdir()
    done = invoke("query", tmp_path / "empty", "pairs")
    assert done.code == 3
    assert len(done.err.splitlines()) == 1
    (tmp_path / "broken.rrd").write_bytes(b"no recording")
    done = invoke("query", tmp_path / "broken.rrd", "pairs")
    assert done.code == 3
    assert "broken.rrd" in done.err
