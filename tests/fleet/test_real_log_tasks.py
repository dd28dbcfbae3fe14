# SPDX-License-Identifier: Apache-2.0
"""Real logs through every executor, with the same tables."""

import os
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import fsspec
import numpy as np
import psutil
import pytest

from multilica import read_extrinsics
from multilica.config import CalibrationConfig, IngestConfig
from multilica.errors import SourceNotFoundError, UsageError
from multilica.fleet.drift.drift import find_outages
from multilica.fleet.fleet_run import FleetOptions, run_fleet
from multilica.fleet.lidar_series import read_series
from multilica.fleet.store.query import ask
from multilica.fleet.store.store import open_store
from multilica.geometry import RigidTransform
from multilica.simulate import true_extrinsics
from tests.fleet.support.buckets import bucket
from tests.fleet.support.small_fleet import PLAN, link_logs, tables, write_ideal_fleet

pytestmark = pytest.mark.slow
OPTIONS = FleetOptions(CalibrationConfig(target="left", ingest=IngestConfig(window="auto")), workers=2)
BROKEN = {log.path for log in PLAN.logs if log.fault}
COPIES = {log.path for log in PLAN.logs if log.duplicate_of}


@pytest.fixture(scope="module")
def fleet(tmp_path_factory):
    return write_ideal_fleet(PLAN, tmp_path_factory.mktemp("simulated") / "fleet")


@pytest.fixture(scope="module")
def whole(fleet, tmp_path_factory):
    store = open_store(tmp_path_factory.mktemp("store"), create=True)
    outcome = run_fleet([str(fleet)], store, replace(OPTIONS, workers=1))
    assert outcome.found == len(PLAN.logs)
    return store


@pytest.fixture(scope="module")
def few(fleet, tmp_path_factory):
    """The logs before the event: broken, calibrated and verified ones, and a copy; at night all."""
    return link_logs(fleet, tmp_path_factory.mktemp("few"), [log for log in PLAN.logs if not log.dead])


def test_each_log_has_its_outcome(whole):
    with ask(whole, "SELECT source, state, reason_text FROM logs") as answer:
        states = {source.removeprefix("fleet/"): (state, text) for source, state, text in answer.rows()}
    assert {*states} == {log.path for log in PLAN.logs}
    assert {path for path, (state, _) in states.items() if state == "failed"} == BROKEN
    assert {path for path, (state, _) in states.items() if state == "duplicate"} == COPIES
    assert all(path in states[path][1] for path in BROKEN)
    counts = [state for state, _ in states.values()]
    assert counts.count("verified") > 0 < counts.count("calibrated")


def test_poses_are_those_of_the_truth(whole):
    logs = {f"fleet/{log.path}": log for log in PLAN.logs}
    count = 0
    with ask(
        whole,
        "SELECT source, lidar, target, x_m, y_m, z_m, qx, qy, qz, qw, sigma_mm FROM lidars "
        "WHERE status = 'placed' AND lidar <> target",
    ) as answer:
        for source, lidar, target, *pose, sigma_mm in answer.rows():
            found = RigidTransform.from_xyz_quaternion(target, lidar, pose[:3], pose[3:])
            true = true_extrinsics(PLAN.rig, PLAN.build_seeds[logs[source].vehicle]).between(target, lidar)
            assert np.linalg.norm(found.xyz_m - true.xyz_m) < 0.02
            assert 0.0 < sigma_mm < 20.0
            count += 1
    assert count >= 8


def test_the_dead_sensor_is_told_with_its_date(whole):
    (event,) = PLAN.events
    first = next(log for log in PLAN.logs if event.lidar in log.dead)
    (outage,) = find_outages(whole)
    assert (outage.vehicle, outage.lidar, outage.reason) == (event.vehicle, event.lidar, "dead_sensor")
    assert outage.lasts
    assert abs(outage.time_ns - first.time_ns) < 10**9
    assert f"{event.lidar} returns nothing since" in outage.sentence
    assert {each.target for each in read_series(whole)} == {"left"}


def test_no_file_holds_a_path_of_the_machine(whole, fleet):
    below = [path for path, _ in whole.files("")]
    assert any(path.endswith("report.html") for path in below)
    for path in below:
        content = whole.read(path)
        assert os.fsencode(fleet.parent) not in content, path
        assert whole.root.encode() not in content, path


def test_the_poses_that_hold_can_be_read(whole):
    with ask(whole, "SELECT DISTINCT calibration FROM logs WHERE state = 'verified'") as answer:
        (path,), *_ = answer.rows()
    assert read_extrinsics(Path(whole.root, path)).members == {"front", "left", "rear", "right"}


@pytest.mark.in_turn
def test_one_vehicle_on_several_workers_has_the_same_tables(whole, fleet, tmp_path):
    (event,) = PLAN.events  # a dead sensor, after which each log is calibrated
    own = [log for log in PLAN.logs if log.vehicle == event.vehicle]
    logs = link_logs(fleet, tmp_path, own[: event.first_log + 1])
    store = open_store(tmp_path / "store", create=True)
    run_fleet([str(logs)], store, replace(OPTIONS, workers=3))
    assert tables(store, logs) == tables(whole, logs)


@contextmanager
def killed_workers():
    """Kill a worker of this process each second, three in all."""
    killed, ended = [], threading.Event()

    def kill():
        while not ended.wait(1.0):
            children = psutil.Process().children()
            if children and len(killed) < 3:
                children[0].kill()
                killed.append(children[0].pid)

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        yield killed
    finally:
        ended.set()
        killer.join()


@pytest.mark.in_turn
def test_a_killed_driver_and_killed_workers_lose_nothing(whole, few, tmp_path):
    store = open_store(tmp_path / "store", create=True)
    command = [sys.executable, "-m", "multilica_cli", "fleet", "run", str(few), "--out", store.root]
    with subprocess.Popen([*command, "--target", "left", "--workers", "2", "-q"]) as driver:
        end_s = time.monotonic() + 60.0
        while not list(store.parts("logs")) and time.monotonic() < end_s:
            time.sleep(0.05)
        children = psutil.Process(driver.pid).children(recursive=True)
        driver.kill()
    _, alive = psutil.wait_procs(children, timeout=30.0)
    assert not alive
    done = len(list(store.parts("logs")))
    assert 0 < done < len(list(few.glob("*/*")))
    with killed_workers() as killed:
        outcome = run_fleet([str(few)], store, OPTIONS)
    assert killed
    assert outcome.skipped >= done
    assert tables(store, few) == tables(whole, few)
    assert not [path for path, _ in store.files("") if ".tmp" in path]


@contextmanager
def cluster(**security):
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50, **security
    ) as made:
        yield made.scheduler_address


@pytest.mark.nightly  # a push runs it with TLS
@pytest.mark.filterwarnings("ignore")
def test_a_dask_cluster_gives_the_same_tables(whole, few, tmp_path):
    store = open_store(tmp_path / "store", create=True)
    with cluster() as address:
        run_fleet([str(few)], store, replace(OPTIONS, scheduler=address))
    assert tables(store, few) == tables(whole, few)


@pytest.mark.in_turn
@pytest.mark.filterwarnings("ignore")
def test_a_dask_cluster_with_tls_gives_the_same_tables(whole, few, tmp_path):
    import dask
    from distributed.security import Security

    security, store = Security.temporary(), open_store(tmp_path / "store", create=True)
    keys = {}
    for name, key in {
        "tls_ca_file": "ca-file",
        "tls_client_cert": "client.cert",
        "tls_client_key": "client.key",
    }.items():
        (tmp_path / name).write_text(getattr(security, name))
        keys[f"distributed.comm.tls.{key}"] = str(tmp_path / name)
    with cluster(security=security, protocol="tls://") as address:
        with pytest.raises(SourceNotFoundError, match="certificates in the configuration of Dask"):
            run_fleet([str(few)], store, replace(OPTIONS, scheduler=address))
        with dask.config.set(keys):
            run_fleet([str(few)], store, replace(OPTIONS, scheduler=address))
    assert tables(store, few) == tables(whole, few)


@pytest.mark.in_turn
def test_a_bucket_holds_the_logs_and_the_store(whole, fleet, tmp_path, monkeypatch):
    logs = link_logs(fleet, tmp_path, [log for log in PLAN.logs if not log.dead])
    with bucket(monkeypatch) as address:
        listed = sorted(logs.glob("*/*"))
        system = fsspec.filesystem("s3", skip_instance_cache=True)
        for path in (each for log in listed for each in ([log] if log.is_file() else log.iterdir())):
            system.put_file(str(path), f"bucket/fleet/{path.relative_to(logs)}")
        store = open_store(f"{address}-store", create=True)
        outcome = run_fleet(["s3://bucket/fleet/"], store, OPTIONS)
        assert outcome.found == len(listed) > 3
        assert any(log.is_dir() for log in listed)
        assert "killed" not in outcome.states
        found, wanted = (_poses(each) for each in (store, whole))
        (recording, *_) = [path for path, _ in store.files("runs") if path.endswith(".rrd")]
        assert store.read(recording).startswith(b"RRF")
    assert {*found} <= {*wanted}
    assert len(found) >= 8
    for key, pose in found.items():
        np.testing.assert_allclose(pose, wanted[key], atol=0.02)


def _poses(store):
    """Those of uncertain LiDARs as well: in logs of one frame, parked cars hold some."""
    query = "SELECT source, lidar, x_m, y_m, z_m FROM lidars WHERE status IN ('placed', 'uncertain')"
    with ask(store, query) as answer:
        return {("/".join(source.rstrip("/").split("/")[-2:]), lidar): pose for source, lidar, *pose in answer.rows()}


def test_an_address_that_is_no_scheduler_is_refused(fleet, tmp_path):
    store = open_store(tmp_path / "store", create=True)
    with pytest.raises(UsageError, match="tcp://HOST:PORT"):
        run_fleet([str(fleet)], store, replace(OPTIONS, scheduler="host:8786"))


@pytest.mark.parametrize(
    ("number", "name", "busy"),
    [(2, "SIGINT", False), pytest.param(2, "SIGINT", True, marks=pytest.mark.nightly), (15, "SIGTERM", True)],
)
def test_a_signal_ends_the_run_with_its_workers(number, name, busy, fleet, tmp_path):
    store = open_store(tmp_path / "store", create=True)
    logs = link_logs(fleet, tmp_path, [log for log in PLAN.logs if log.fault or log.vehicle == PLAN.events[0].vehicle])
    command = [sys.executable, "-m", "multilica_cli", "fleet", "run", str(logs), "--out", store.root]
    with subprocess.Popen([*command, "--target", "left"], stderr=subprocess.PIPE, text=True) as driver:
        end_s = time.monotonic() + 60.0
        while time.monotonic() < end_s:
            children = psutil.Process(driver.pid).children()
            if children and (not busy or list(store.parts("logs"))):
                break
            time.sleep(0.05)
        driver.send_signal(number)
        assert driver.wait(10.0) == 128 + number
        assert driver.stderr.read().splitlines()[-1].startswith(f"multilica: Stopped by {name}")
    _, alive = psutil.wait_procs(children, timeout=10.0)
    assert not alive
    with ask(store, "SELECT count(*) FROM logs WHERE reason = 'killed'") as answer:
        assert list(answer.rows()) == [(0,)]
