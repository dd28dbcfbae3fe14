# SPDX-License-Identifier: Apache-2.0
"""A log of a fleet is read and calibrated once; how much its recording holds follows from the outcome."""

import pytest

from multilica.config import CalibrationConfig
from multilica.events import CalibrationFinished, CalibrationStarted
from multilica.fleet.store.store import open_store
from multilica.fleet.tasks import run_task
from multilica.runs.run_documents import read_run_document
from tests.fleet.support.requests import request
from tests.sinks.made_events import made_events


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
