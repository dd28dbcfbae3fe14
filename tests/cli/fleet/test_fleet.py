# SPDX-License-Identifier: Apache-2.0
import csv
import json
import shutil
import socket
import subprocess
import time
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import psutil
import pytest

from multilica import read_snapshot
from multilica.config import IngestConfig
from multilica.fleet.store.query import ask
from multilica.fleet.store.store import open_store
from multilica.fleet.store.upkeep import prune_recordings
from multilica.simulate import thinned
from multilica.sinks.snapshots import write_snapshot_mcap
from multilica_cli.commands.calibrate import find_sample
from multilica_cli.exit_codes import ExitCode
from tests.cli.support import Invoke, assert_one_sentence, command_of_process, environment_of_process
from tests.fleet.support.made_store import add_log, key_of, lidar_row, made_store
from tests.sinks.conftest import record


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("fleet") / "store"
    made_store(folder)
    return folder


@pytest.fixture
def store(made, tmp_path) -> Path:
    shutil.copytree(made, tmp_path / "store")
    return tmp_path / "store"


def rows(outcome):
    return list(csv.reader(outcome.out.splitlines()))


@pytest.mark.slow
def test_a_log_ends_in_the_tables(invoke: Invoke, tmp_path):
    """It has one frame, which needs no flag."""
    logs = tmp_path / "logs" / "truck-7"
    logs.mkdir(parents=True)
    sample = thinned(read_snapshot(find_sample().recording, config=IngestConfig(frames=1)), 3)
    write_snapshot_mcap(sample, logs / "2026-03-01.mcap")
    (logs / "broken.mcap").write_bytes(bytes(100))
    outcome = invoke("fleet", "run", logs.parent, "--out", "store", "--workers", "1")
    assert outcome.code == ExitCode.NOT_PLACED
    assert outcome.out.splitlines() == [
        "2 logs, 0 of them finished before: 1 calibrated, 1 failed.",
        "For the reasons: multilica fleet failures --store store",
    ]
    assert "truck-7: logs/truck-7/broken.mcap: failed:" in outcome.err
    found = rows(
        invoke(
            "fleet",
            "query",
            "SELECT vehicle, lidar, status FROM lidars ORDER BY lidar",
            "--store",
            "store",
            "--format",
            "csv",
        )
    )
    assert found[0] == ["vehicle", "lidar", "status"]
    assert {tuple(row) for row in found[1:]} == {
        ("truck-7", name, "placed") for name in ("front", "left", "rear", "right")
    }
    again = invoke("fleet", "run", logs.parent, "--out", "store", "--json")
    assert (again.code, json.loads(again.out)) == (ExitCode.DONE, {"found": 2, "skipped": 2})
    assert len(rows(invoke("fleet", "failures", "--store", "store", "--format", "csv"))) == 2


@pytest.mark.in_turn
@pytest.mark.slow
def test_logs_unlike_the_pattern_are_told(invoke: Invoke, tmp_path):
    for name in ("cars/v1", "trucks"):
        (tmp_path / "logs" / name).mkdir(parents=True)
        (tmp_path / "logs" / name / "log.mcap").write_bytes(bytes(100))
    command = ("fleet", "run", "logs", "--out", "store", "--workers", "1", "--pattern")
    assert_one_sentence(invoke(*command, "bikes/{vehicle}/"), ExitCode.USAGE)
    outcome = invoke(*command, "cars/{vehicle}/")
    assert outcome.code == ExitCode.NOT_PLACED
    assert "note: logs that the pattern does not fit: 1; their vehicle is from" in outcome.err
    outcome = invoke(*command, "cars/{vehicle}/", "--json")
    assert json.loads(outcome.out) == {"found": 2, "skipped": 2, "unlike_pattern": 1}
    found = rows(invoke("fleet", "query", "SELECT vehicle FROM logs ORDER BY 1", "--store", "store", "--format", "csv"))
    assert found[1:] == [["trucks"], ["v1"]]


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("run", "none", "--out", "new"), ExitCode.INPUT, "Nothing exists at none"),
        (("run", ".", "--out", "https://host/store"), ExitCode.USAGE, "s3://BUCKET/PREFIX"),
        (("run", ".", "--out", "new", "--pattern", "*"), ExitCode.USAGE, "pattern"),
        (("run", ".", "--out", "new", "--pattern", "{}/{vehicle}"), ExitCode.USAGE, "Found {} in the pattern"),
        (("run", ".", "--out", "new", "--scheduler", "host"), ExitCode.USAGE, "tcp://HOST:PORT"),
        (("run", ".", "--out", "new", "--set", "fine.none=1"), ExitCode.USAGE, "fine.none"),
        (("status", "--store", "none"), ExitCode.INPUT, "no fleet store at none"),
        (("show", "v9", "--store", "store"), ExitCode.INPUT, "no vehicle 'v9'; it has v01"),
        (("query", "SELECT none FROM logs", "--store", "store"), ExitCode.USAGE, "cannot be answered"),
        (("query", "", "--store", "store"), ExitCode.USAGE, "question is empty"),
        (("drift", "--store", "store", "--false-alarm-rate", "2"), ExitCode.USAGE, "false-alarm rate is 2"),
        (("browse", "--store", "store", "--vehicle", "v9"), ExitCode.INPUT, "no recordings of v9"),
    ],
)
def test_a_wrong_request_gets_a_sentence(arguments, code, words, store, invoke: Invoke):
    outcome = invoke("fleet", *(store if each == "store" else each for each in arguments))
    assert_one_sentence(outcome, code)
    assert words in outcome.err
    assert not Path("new", "logs").exists()


def test_the_status_is_that_of_the_tables(store, invoke: Invoke):
    header, *found = rows(invoke("fleet", "status", "--store", store, "--format", "csv"))
    with ask(open_store(store, create=False), "SELECT vehicle, count(*) FROM logs GROUP BY 1 ORDER BY 1") as answer:
        assert [(row[0], int(row[1])) for row in found] == list(answer.rows())
    assert header[:4] == ["vehicle", "logs", "first", "last"]
    text = invoke("fleet", "status", "--store", store).out
    assert all(row[0] in text for row in found)


def test_a_vehicle_is_shown_log_by_log(store, invoke: Invoke):
    lines = invoke("fleet", "show", "v02", "--store", store, "--format", "json").out.splitlines()
    shown = [json.loads(line) for line in lines]
    with ask(open_store(store, create=False), "SELECT count(*) FROM lidars WHERE vehicle = 'v02'") as answer:
        assert list(answer.rows()) == [(len(shown),)]
    front = next(row for row in shown if row["lidar"] == "front")
    assert front["x_m"] == pytest.approx(2.0, abs=0.1)
    assert front["yaw_deg"] == pytest.approx(40.0, abs=2.0)


@pytest.mark.slow
def test_drift_is_told_and_ends_with_its_code(store, invoke: Invoke):
    outcome = invoke("fleet", "drift", "--store", store)
    assert outcome.code == ExitCode.DIFFERENT
    document = json.loads(invoke("fleet", "drift", "--store", store, "--json").out)
    told = [each["sentence"] for kind in ("moved", "offset", "lost") for each in document[kind]]
    assert outcome.out.splitlines() == told
    moved = [(each["vehicle"], each["lidars"], each["kind"]) for each in document["moved"]]
    assert moved == [("v01", ["front"], "jump")]


def test_a_fleet_at_rest_has_no_drift(tmp_path, invoke: Invoke):
    store = open_store(tmp_path / "rest", create=True)
    for day in range(6):
        add_log(store, "v01", 7 * day, lambda *given: [lidar_row(*given, "front")])
    outcome = invoke("fleet", "drift", "--store", store.root)
    assert (outcome.code, outcome.out) == (ExitCode.DONE, "No LiDAR of 1 vehicles has moved.\n")


@pytest.mark.slow
def test_old_recordings_are_removed_by_their_rule(store, invoke: Invoke):
    opened = open_store(store, create=False)
    recordings = {path for path, _ in opened.files("runs")}
    assert recordings
    assert invoke("fleet", "prune", "--store", store).out == "0 files removed, 0.0 MB.\n"
    later = datetime.now(UTC) + timedelta(days=31)
    assert prune_recordings(opened, success_days=30.0, failure_days=60.0, now=later)[0] <= len(recordings)
    with ask(opened, "SELECT count(*) FROM lidars") as answer:
        ((count,),) = answer.rows()
    prune_recordings(opened, success_days=0.0, failure_days=0.0, now=later)
    assert not {path for path, _ in opened.files("runs") if path.endswith((".rrd", ".html", ".mcap"))}
    with ask(opened, "SELECT count(*) FROM lidars") as answer:
        assert list(answer.rows()) == [(count,)]


def test_compaction_leaves_one_part_per_month(store, invoke: Invoke):
    before = rows(invoke("fleet", "status", "--store", store, "--format", "csv"))
    outcome = invoke("fleet", "compact", "--store", store)
    assert outcome.code == ExitCode.DONE
    folders = [path.parent for path in store.glob("l*/*/*/*.parquet")]
    assert len(folders) == len({*folders})
    assert rows(invoke("fleet", "status", "--store", store, "--format", "csv")) == before


@pytest.mark.in_turn
@pytest.mark.slow
def test_the_catalog_listens_on_loopback_alone(tmp_path):
    store = open_store(tmp_path / "store", create=True)
    key = add_log(store, "v01", 1, lambda *given: [lidar_row(*given, "front")], state="calibrated")
    with ask(store, "SELECT recording FROM logs") as answer:
        ((recording,),) = answer.rows()
    assert key in recording
    store.put(record(tmp_path / "recording.rrd", "complete"), recording)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = command_of_process("fleet", "browse", "--store", store.root, "--port", str(port))
    with subprocess.Popen(
        command, env=environment_of_process(), stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as server:
        try:
            end_s, listening = time.monotonic() + 60.0, set()
            while not listening and time.monotonic() < end_s:
                time.sleep(0.2)
                own = [psutil.Process(server.pid), *psutil.Process(server.pid).children(recursive=True)]
                sockets = [each for process in own for each in process.net_connections("tcp")]
                listening = {each.laddr for each in sockets if each.status == psutil.CONN_LISTEN}
            assert listening == {("127.0.0.1", port)}
        finally:
            children = psutil.Process(server.pid).children(recursive=True)
            server.terminate()
            server.wait(30.0)
    _, alive = psutil.wait_procs(children, timeout=20.0)
    assert not alive


@pytest.mark.in_turn
@pytest.mark.slow
@pytest.mark.parametrize("content", [b"", b"no Parquet"])
def test_a_damaged_part_is_named(content, store, invoke: Invoke):
    part = min(store.glob("lidars/*/*/*.parquet"))
    part.write_bytes(content)
    for command in (("status",), ("drift",), ("compact",), ("show", "v01"), ("report",)):
        outcome = invoke("fleet", *command, "--store", store)
        if outcome.code != ExitCode.DONE:
            assert_one_sentence(outcome, ExitCode.INPUT)
            assert f"The part {part.relative_to(store)} of the store" in outcome.err
    assert invoke("fleet", "drift", "--store", store).code == ExitCode.INPUT


@pytest.mark.slow
def test_a_damaged_store_is_repaired(store, invoke: Invoke):
    part = min(store.glob("lidars/*/*/*.parquet"))
    part.write_bytes(b"no Parquet")
    whole = invoke("fleet", "status", "--store", store, "--format", "csv")
    assert (whole.code, len(rows(whole))) == (ExitCode.DONE, 4)
    assert whole.err == (
        f"note: parts that are damaged and left out: 1; `multilica fleet repair --store {store}` sets them aside.\n"
    )
    assert invoke("fleet", "failures", "--store", store).code == ExitCode.INPUT
    source = next(f"v01/{day}.mcap" for day in range(400) if key_of(f"v01/{day}.mcap") == part.stem)
    assert invoke("fleet", "repair", "--store", store).out.splitlines() == [
        f"{part.relative_to(store)} is damaged; it is now in {store}/damaged.",
        f"v01: {source}: the next run treats it again.",
    ]
    assert invoke("fleet", "failures", "--store", store).code == ExitCode.DONE
    assert invoke("fleet", "status", "--store", store).err == ""
    assert invoke("fleet", "repair", "--store", store).out == "No part is damaged.\n"


@pytest.mark.in_turn
@pytest.mark.slow
def test_a_damaged_row_of_a_log_is_written_again(tmp_path, invoke: Invoke):
    (tmp_path / "v1").mkdir()
    (tmp_path / "v1" / "log.mcap").write_bytes(bytes(100))
    command = ("fleet", "run", "v1", "--out", "store", "--workers", "1")
    invoke(*command)
    (part,) = (tmp_path / "store").glob("logs/*/*/*.parquet")
    whole = part.read_bytes()
    part.write_bytes(whole[:50])
    assert invoke(*command).out.startswith("1 logs, 0 of them finished before: 1 failed")
    assert len(part.read_bytes()) == len(whole)


def test_a_row_of_a_newer_version_takes_the_place_of_the_older(tmp_path):
    store = open_store(tmp_path / "store", create=True)
    add_log(store, "v01", 1, lambda *given: [lidar_row(*given, "front")])
    with ask(store, "SELECT key FROM logs") as answer:
        ((key,),) = answer.rows()
    from multilica.fleet.store.records import LogRow
    from tests.fleet.support.requests import DAY_NS, START_NS

    newer = LogRow("0" * 32, "v01", START_NS + DAY_NS, "v01/1.mcap", key, 1000, "verified", version="9")
    store.finish(replace(newer, finished_at=datetime.now(UTC)), [])
    with ask(store, "SELECT version FROM logs") as answer:
        assert list(answer.rows()) == [("9",)]
