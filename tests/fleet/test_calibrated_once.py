# SPDX-License-Identifier: Apache-2.0
"""A log of a fleet is read and calibrated once; how much its recording holds follows from the outcome."""

from dataclasses import replace

import pytest
import tomli_w

from multilica.config import CalibrationConfig
from multilica.events import CalibrationFinished, CalibrationStarted
from multilica.extrinsics import Extrinsics, extrinsics_table
from multilica.fleet.store.records import LidarRow
from multilica.fleet.store.store import open_store
from multilica.fleet.tasks import run_task
from multilica.geometry import RigidTransform
from multilica.runs.run_documents import read_run_document
from tests.fleet.support.requests import request
from tests.sinks.made_events import made_events


@pytest.mark.parametrize("verified", [True, False])
def test_a_lidar_that_is_not_in_the_log_is_lost(tmp_path, monkeypatch, verified):
    made = list(made_events("complete"))
    (start,) = (each for each in made if isinstance(each, CalibrationStarted))
    names = start.snapshot.names
    known = Extrinsics(names[0], {name: RigidTransform.identity(names[0], name) for name in (*names[1:], "gone")})
    store = open_store(tmp_path / "store", create=True)
    store.write("reference.toml", tomli_w.dumps(extrinsics_table(known)).encode())
    row = LidarRow("", None, "a.mcap", names[0], names[0], "verified", "placed")
    monkeypatch.setattr(run_task, "read_snapshot", lambda *_, **__: start.snapshot)
    monkeypatch.setattr(run_task, "_verified_rows", lambda *_: [row] if verified else [])
    monkeypatch.setattr(run_task, "_calibrated", lambda _, __, log, *___: (replace(log, state="calibrated"), [row]))
    log = run_task.run_log_task(request(tmp_path, "a.mcap", reference="reference.toml"))
    assert log.state == ("verified" if verified else "calibrated")
    found = {each["lidar"]: each for each in store.dataset("lidars").to_table().to_pylist()}
    assert {name: each["reason"] for name, each in found.items()} == {names[0]: "", "gone": "no_topic"}
    assert (found["gone"]["status"], found["gone"]["target"]) == ("not_placed", names[0])


@pytest.mark.parametrize(("outcome", "detail"), [("complete", "slim"), ("partial", "full")])
def test_a_log_is_calibrated_once(outcome, detail, tmp_path, monkeypatch):
    made = list(made_events(outcome))
    (start,) = (each for each in made if isinstance(each, CalibrationStarted))
    (end,) = (each for each in made if isinstance(each, CalibrationFinished))
    calls = []

    def calibrate(snapshot, config, observe, prior):
        calls.append((snapshot, config.record.detail, prior))
        for event in made:
            observe(event)
        return end.result

    reads = []
    monkeypatch.setattr(run_task, "calibrate", calibrate)
    monkeypatch.setattr(run_task, "read_snapshot", lambda *_, **__: reads.append(1) or start.snapshot)
    task = request(tmp_path, "a.mcap")
    row = run_task.run_log_task(task)
    assert row.state == "calibrated", row.reason_text
    assert calls == [(start.snapshot, "slim", None)]
    assert reads == [1]
    store = open_store(tmp_path / "store", create=False)
    files = store.run_folder(task.vehicle, task.time_ns, task.key)
    document = read_run_document(tmp_path / "store" / files).document
    assert document.status == outcome
    assert CalibrationConfig.model_validate(document.config).record.detail == detail
