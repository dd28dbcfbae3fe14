# SPDX-License-Identifier: Apache-2.0
"""Disks and buckets that are full, read-only or refuse: the run ends, no log is marked, and the next run goes on."""

import errno
import os
from contextlib import contextmanager
from pathlib import Path

import duckdb
import fsspec
import pytest

from multilica.errors import SourceNotFoundError, StorageError, UnreadableSourceError
from multilica.fleet import fleet_run
from multilica.fleet.store import store as store_module
from multilica.fleet.store.store import Store, open_store
from multilica.fleet.tasks import guard, run_task
from multilica.fleet.tasks.guard import LogTaskLimits, identify_guarded, run_guarded
from tests.fleet.support.buckets import bucket
from tests.fleet.support.requests import request

LIMITS = LogTaskLimits(time_s=60.0, memory_mb=500.0, retries=2)


class RefusedError(Exception):
    """An error of a client of S3."""

    def __init__(self, status, code):
        super().__init__("with a secret")
        self.status, self.response = status, {"Error": {"Code": code}}


class RefusingSystem:
    """A bucket that refuses everything."""

    def __init__(self, error):
        self._error = error

    def _refuse(self, *_, **__):
        raise self._error

    pipe_file = put_file = cat_file = rm_file = invalidate_cache = _refuse


@pytest.mark.parametrize("code", ["ENOSPC", "EDQUOT", "EROFS", "EACCES"])
def test_a_disk_that_refuses_is_named(code, tmp_path, monkeypatch):
    store = open_store(tmp_path / "store", create=True)
    number = getattr(errno, code)

    @contextmanager
    def refused(path):
        raise OSError(number, os.strerror(number), str(path))
        yield

    monkeypatch.setattr(store_module, "atomic_file", refused)
    with pytest.raises(StorageError) as caught:
        store.write("logs/a", b"content")
    assert f"to write a file: {store}/logs/a ({os.strerror(number)}); free space" in str(caught.value)
    assert not caught.value.passes


@pytest.mark.parametrize(
    ("error", "words", "passes"),
    [
        (RefusedError(403, "QuotaExceeded"), "is denied; set AWS_ACCESS_KEY_ID", False),
        (RefusedError(507, "XMinioStorageFull"), r"status 507; try again later \(XMinioStorageFull\)\.", False),
        (RefusedError(404, "NoSuchBucket"), r"Nothing exists .* \(NoSuchBucket\)\.", False),
        (ConnectionError("reset"), "connection to the server of", True),
    ],
)
def test_a_bucket_that_refuses_is_named(error, words, passes):
    store = Store("s3://key:word@bucket/fleet", RefusingSystem(error), "bucket/fleet")
    for use in (lambda: store.write("a", b""), lambda: store.put(Path(os.devnull), "a")):
        with pytest.raises(StorageError, match=words) as caught:
            use()
        assert caught.value.passes is passes
        assert "secret" not in str(caught.value)
        assert "word" not in str(caught.value)
    with pytest.raises(SourceNotFoundError if "NoSuch" in words else StorageError):
        store.read("a")


def test_a_folder_that_cannot_be_listed_is_not_empty(tmp_path, monkeypatch):
    store = open_store(tmp_path / "store", create=True)

    def refused(place, onerror):
        onerror(PermissionError(errno.EACCES, "Permission denied", str(place)))
        yield from ()

    monkeypatch.setattr(store_module.os, "walk", refused)
    with pytest.raises(StorageError, match="Permission denied"):
        list(store.parts("logs"))


@pytest.fixture
def failing_tasks(monkeypatch):
    monkeypatch.setattr(guard, "_SERVER", "tests.fleet.support.failing_tasks")
    monkeypatch.setattr(guard, "_PAUSES_S", (0.0,))
    guard._STOPPED.clear()
    yield
    guard.end_processes()


@pytest.mark.slow
@pytest.mark.usefixtures("failing_tasks")
@pytest.mark.parametrize(("source", "words"), [("full-1", "No space left on device"), ("refusing-1", "store refuses")])
def test_a_log_is_not_marked_for_a_disk(tmp_path, source, words):
    with pytest.raises(StorageError, match=words):
        run_guarded(request(tmp_path, source), LIMITS)
    assert list(open_store(tmp_path / "store", create=False).parts("logs")) == []


@pytest.mark.slow
@pytest.mark.usefixtures("failing_tasks")
def test_a_store_that_answers_again_has_the_row(tmp_path):
    assert run_guarded(request(tmp_path, "away-1"), LIMITS).reason == "stub"


@pytest.mark.slow
@pytest.mark.usefixtures("failing_tasks")
def test_a_log_is_not_named_after_its_folder_for_a_disk(tmp_path):
    with pytest.raises(StorageError, match="No space left on device"):
        identify_guarded(str(tmp_path / "full-1"), LIMITS)


def test_a_log_that_was_not_unpacked_for_a_disk_has_no_row(tmp_path, monkeypatch):
    def outcome(*_):
        full = OSError(errno.EDQUOT, "Disk quota exceeded", "unpacked")
        raise UnreadableSourceError("a.mcap cannot be unpacked.") from full

    monkeypatch.setattr(run_task, "_outcome", outcome)
    with pytest.raises(StorageError, match=r"temporary file .* \(Disk quota exceeded\)"):
        run_task.run_log_task(request(tmp_path, "a.mcap"))
    assert list(open_store(tmp_path / "store", create=False).parts("logs")) == []


def test_a_plan_that_does_not_fit_on_its_disk_ends_the_run(tmp_path, monkeypatch):
    def full(*_):
        raise duckdb.IOException('Could not write file "plan.duckdb": No space left on device')

    monkeypatch.setattr(fleet_run.Plan, "add", full)
    store = open_store(tmp_path / "store", create=True)
    with pytest.raises(StorageError, match=r"No space left on device\); free space, or choose another TMPDIR"):
        fleet_run.run_fleet([str(tmp_path)], store, fleet_run.FleetOptions())


@pytest.mark.slow
def test_the_reason_of_s3_is_told(monkeypatch):
    with bucket(monkeypatch) as address:
        store = open_store(address, create=True)
        fsspec.filesystem("s3", skip_instance_cache=True).rm("bucket", recursive=True)
        with pytest.raises(StorageError, match=r"Nothing exists at s3://bucket/fleet/a \(NoSuchBucket\)\."):
            store.write("a", b"content")
