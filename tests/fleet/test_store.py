# SPDX-License-Identifier: Apache-2.0
import json
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from urllib.parse import unquote

import duckdb
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from multilica.errors import SourceNotFoundError, UnreadableSourceError, UsageError
from multilica.fleet.drift.drift import find_outages
from multilica.fleet.store.query import ask
from multilica.fleet.store.records import TABLES, LidarRow, LogRow
from multilica.fleet.store.store import folder_name, open_store, vehicle_name
from multilica.fleet.store.upkeep import prune_recordings
from tests.fleet.support.buckets import bucket
from tests.fleet.support.requests import DAY_NS, START_NS

KEY = "0123456789abcdef0123456789abcdef"
LOG = LogRow(KEY, "v1", START_NS, "a/b.mcap", "f", 3, "calibrated", reason_text="", artifacts_mb=0.5)
LIDAR = LidarRow(KEY, START_NS, "a/b.mcap", "left", "top", "calibrated", "placed", x_m=1.25, covariance=(0.5,) * 36)


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize("place", ["disk", "bucket"])
def test_rows_come_back_with_the_vehicle_of_their_folder(tmp_path, monkeypatch, place):
    with bucket(monkeypatch) if place == "bucket" else _folder(tmp_path / "store") as address:
        store = open_store(address, create=True)
        assert list(store.parts("logs")) == []
        store.finish(LOG, [LIDAR])
        store.finish(replace(LOG, key=KEY[::-1], vehicle="../7 ä", time_ns=None), [])
        store = open_store(address, create=False)
        (lidar,) = store.dataset("lidars").to_table().to_pylist()
        assert (lidar["vehicle"], lidar["month"], lidar["x_m"], lidar["covariance"]) == (
            "v1",
            "2026-01",
            1.25,
            [0.5] * 36,
        )
        assert lidar["time"].isoformat() == "2026-01-01T00:00:00+00:00"
        logs = {row["vehicle"]: row for row in store.dataset("logs").to_table().to_pylist()}
        assert {*logs} == {"v1", "../7 ä"}
        assert logs["../7 ä"]["month"] == "unknown"
        assert logs["v1"]["artifacts_mb"] == 0.5
        path = tmp_path / "file"
        path.write_bytes(b"content")
        assert store.put(path, "runs/v1/x/file") == 7
        assert store.read("runs/v1/x/file") == b"content"
        assert ("runs/v1/x/file", 7) in store.files("runs")
        store.remove("runs/v1/x/file")
        store.remove("runs/v1/x/file")
        with pytest.raises(SourceNotFoundError, match=r"has no runs/v1/x/file"):
            store.read("runs/v1/x/file")


@contextmanager
def _folder(path):
    yield str(path)


def test_other_readers_read_the_parts(tmp_path):
    store = open_store(tmp_path, create=True)
    store.finish(replace(LOG, vehicle="v 1"), [LIDAR])
    found = duckdb.read_parquet(f"{tmp_path}/lidars/**/*.parquet", hive_partitioning=True)
    assert found.select("vehicle", "lidar").fetchall() == [("v 1", "left")]
    (part,) = store.parts("lidars")
    schema = pq.read_schema(tmp_path / part)
    assert schema.equals(TABLES["lidars"])
    assert schema.metadata[b"multilica.schema_version"] == b"1"


@pytest.mark.slow
@pytest.mark.in_turn
@given(st.text())
def test_any_text_of_a_log_is_one_folder_below_the_store(text):
    name = vehicle_name(text)
    folder = folder_name(name)
    assert folder == Path(folder).name
    assert "." not in folder
    assert 0 < len(folder.encode()) <= 200
    assert unquote(folder) == name


@pytest.mark.parametrize(
    ("content", "words"),
    [("{", "expected its format"), ("{}", "expected its format"), ('{"schema_version": 99}', "version 99")],
)
def test_a_store_of_another_version_is_refused(tmp_path, content, words):
    (tmp_path / "fleet.json").write_text(content)
    with pytest.raises(UnreadableSourceError, match=words):
        open_store(tmp_path, create=True)


def test_a_folder_with_other_things_is_no_store(tmp_path):
    (tmp_path / "notes.txt").touch()
    with pytest.raises(UsageError, match="not empty"):
        open_store(tmp_path, create=True)
    with pytest.raises(SourceNotFoundError, match="fleet run LOGS --out"):
        open_store(tmp_path / "none", create=False)
    with pytest.raises(UsageError, match="s3://BUCKET/PREFIX"):
        open_store("https://example.com/store", create=True)


def test_a_log_whose_file_grew_stands_there_once(tmp_path):
    """While it was sent, it could not be read, and then in part."""
    store = open_store(tmp_path, create=True)
    begin_ns, end = 10**18, datetime(2026, 1, 1, tzinfo=UTC)
    for number, (time_ns, state) in enumerate([(None, "failed"), (begin_ns, "calibrated"), (begin_ns, "calibrated")]):
        key, minutes = str(number), timedelta(minutes=number)
        log = LogRow(key, "v1", time_ns, "v1/a.mcap", f"bytes {key}", number, state, finished_at=end + minutes)
        store.finish(log, [LidarRow(key, time_ns, log.source, "left", "top", "calibrated", "placed")])
    for number, time_ns in enumerate((begin_ns, begin_ns + 10**9)):
        log = LogRow(f"watch-{number}", "v1", time_ns, "ros2://", "", 0, "verified", finished_at=end)
        store.finish(log, [LidarRow(log.key, time_ns, log.source, "left", "top", "verified", "placed")])
    for table in ("logs", "lidars"):
        with ask(store, f"SELECT key FROM {table} ORDER BY key") as answer:  # noqa: S608
            assert list(answer.rows()) == [("2",), ("watch-0",), ("watch-1",)]


@pytest.mark.parametrize(
    ("changed", "keys"),
    [
        ({"vehicle": "v2", "fingerprint": "other"}, [KEY, KEY[::-1]]),
        ({"vehicle": "v2"}, [KEY[::-1]]),
        ({"time_ns": START_NS + DAY_NS}, [KEY[::-1]]),
        ({"time_ns": START_NS + DAY_NS, "fingerprint": "other"}, [KEY[::-1]]),
        ({"vehicle": "v2", "fingerprint": "other", "state": "failed"}, [KEY]),
    ],
    ids=["another vehicle's", "renamed vehicle", "another time", "changed file", "failed"],
)
def test_a_log_is_known_by_its_file_or_its_vehicle(tmp_path, changed, keys):
    store = open_store(tmp_path, create=True)
    end = datetime(2026, 1, 1, tzinfo=UTC)
    store.finish(replace(LOG, finished_at=end), [])
    store.finish(replace(LOG, key=KEY[::-1], finished_at=end + timedelta(minutes=1), **changed), [])
    with ask(store, "SELECT key FROM logs ORDER BY key") as answer:
        assert [key for (key,) in answer.rows()] == keys


def test_a_copy_of_a_log_without_poses_is_none(tmp_path):
    store = open_store(tmp_path, create=True)
    for state, first in (("failed", "copy"), ("refused", "copy"), ("calibrated", "a/b.mcap")):
        store.finish(replace(LOG, state=state), [])
        assert store.first_with(state, "v1", "c", LOG.source) == LOG.source
        assert store.first_with(state, "v1", "c", "copy") == first


def test_files_of_earlier_configurations_are_pruned(tmp_path):
    store = open_store(tmp_path, create=True)
    end = datetime(2026, 1, 1, tzinfo=UTC)
    for number in range(2):
        folder = f"runs/v1/2026-01/{number}"
        store.write(f"{folder}/recording.rrd", b"12")
        log = replace(LOG, key=str(number), recording=f"{folder}/recording.rrd", config_sha256=str(number))
        store.finish(replace(log, finished_at=end + timedelta(days=number)), [replace(LIDAR, key=log.key)])
    kept = {"success_days": 10.0, "failure_days": 0.0}
    assert prune_recordings(store, **kept, now=end + timedelta(days=9)) == (0, 0)
    assert prune_recordings(store, **kept, now=end + timedelta(days=10, hours=1)) == (1, 2)
    assert prune_recordings(store, **kept, now=end + timedelta(days=12)) == (1, 2)


def test_a_lidar_is_lost_whatever_the_reasons(tmp_path):
    store = open_store(tmp_path, create=True)
    for number, reason in enumerate(["", "no_topic", "dead_sensor", "no_topic", "dead_sensor"]):
        log = replace(LOG, key=str(number), source=f"{number}.mcap", time_ns=START_NS + number * DAY_NS)
        status = "not_placed" if reason else "placed"
        lidar = replace(LIDAR, key=log.key, time_ns=log.time_ns, source=log.source, status=status, reason=reason)
        store.finish(log, [lidar])
    (outage,) = find_outages(store)
    assert (outage.reason, outage.key, outage.logs, outage.lasts) == ("dead_sensor", "1", 4, True)


def test_the_layout_is_written(tmp_path):
    open_store(tmp_path / "new", create=True)
    assert json.loads((tmp_path / "new" / "fleet.json").read_text()) == {
        "format": "multilica fleet store",
        "schema_version": 1,
    }
    time_ns = START_NS + 40 * DAY_NS
    assert open_store(tmp_path / "new", create=False).run_folder("a/b", time_ns, KEY) == f"runs/a%2Fb/2026-02/{KEY}"
