# SPDX-License-Identifier: Apache-2.0
"""Objects of Google Cloud Storage, on a server that speaks its language."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from urllib.request import Request, urlopen

import pytest

from multilica.config import IngestConfig
from multilica.errors import SourceNotFoundError, UnreadableSourceError
from multilica.fleet.listing import find_logs
from multilica.ingest import read_snapshot
from tests.ingest.support.processes import served
from tests.ingest.support.served_files import (
    BUCKET,
    assert_a_window_costs_its_chunks,
    assert_equal_to_the_file,
    write_files,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_files(tmp_path_factory.mktemp("served"))


@pytest.fixture(scope="module")
def gcs_port(folder: Path) -> Iterator[int]:
    with served("gcs_server.py") as port:
        _post(f"http://127.0.0.1:{port}/storage/v1/b?project=fleet", json.dumps({"name": BUCKET}).encode(), "json")
        upload = f"http://127.0.0.1:{port}/upload/storage/v1/b/{BUCKET}/o?uploadType=media&name="
        _post(f"{upload}june%2Flong.mcap", (folder / "long.mcap").read_bytes(), "octet-stream")
        for path in (folder / "bag").iterdir():
            _post(f"{upload}june%2Fbag%2F{path.name}", path.read_bytes(), "octet-stream")
        yield port


def _post(url: str, data: bytes, kind: str) -> None:
    with urlopen(Request(url, data, {"Content-Type": f"application/{kind}"})) as answer:  # noqa: S310 - on loopback
        answer.read()


@pytest.fixture
def gs(gcs_port: int, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("STORAGE_EMULATOR_HOST", f"http://127.0.0.1:{gcs_port}")
    monkeypatch.setenv("FSSPEC_GS_TOKEN", "anon")
    return f"gs://{BUCKET}/june/long.mcap"


@pytest.mark.slow
def test_a_window_of_a_gcs_object_costs_its_chunks(gs: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from gcsfs.core import GCSFile

    assert_a_window_costs_its_chunks(GCSFile, gs, folder / "long.mcap", monkeypatch)


@pytest.mark.slow
def test_a_bag_in_a_bucket_is_read_as_one(gs: str, folder: Path) -> None:
    bag = gs.replace("long.mcap", "bag/")
    assert_equal_to_the_file(bag, folder / "bag", IngestConfig(frames=3))
    assert [log.source for log in find_logs([gs.replace("june/long.mcap", "")])] == [bag, gs]


def test_what_gcs_does_not_have_is_told(gs: str) -> None:
    with pytest.raises(SourceNotFoundError, match=r"Nothing exists at gs://fleet-logs/june/other\.mcap\."):
        read_snapshot(gs.replace("long", "other"))
    with pytest.raises(SourceNotFoundError, match=r"Nothing exists at gs://no-bucket/a\.mcap\."):
        read_snapshot("gs://no-bucket/a.mcap")


def test_a_server_that_is_not_there_is_one_sentence(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STORAGE_EMULATOR_HOST", "http://127.0.0.1:1")
    monkeypatch.setenv("FSSPEC_GS_TOKEN", "anon")
    monkeypatch.setattr("gcsfs.retry.asyncio.sleep", _briefly)
    with pytest.raises(UnreadableSourceError, match=r"The connection to the server of gs://logs/a\.mcap failed"):
        read_snapshot("gs://logs/a.mcap")
    assert capfd.readouterr() == ("", "")


async def _briefly(_: float) -> None:
    """In place of the half minute for which the client tries again."""
