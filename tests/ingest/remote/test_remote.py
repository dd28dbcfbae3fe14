# SPDX-License-Identifier: Apache-2.0
"""Files on servers, which run in processes of their own."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from urllib.request import urlopen

import pytest

from multilica.config import IngestConfig
from multilica.errors import (
    MissingDependencyError,
    MultilicaError,
    SourceNotFoundError,
    UnreadableSourceError,
    UsageError,
)
from multilica.fleet.listing import find_logs
from multilica.fleet.patterns import LogPattern
from multilica.ingest import find_snapshots, inspect_source, read_snapshot
from multilica.ingest.metadata import identify_log
from multilica.ingest.remote import remote_file
from multilica.ingest.remote.remote_file import RemoteFile
from tests.ingest.support.processes import served
from tests.ingest.support.served_files import (
    BUCKET,
    WINDOW,
    assert_a_window_costs_its_chunks,
    assert_equal_to_the_file,
    needed_bytes,
    write_files,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_files(tmp_path_factory.mktemp("served"))


@pytest.fixture(scope="module")
def web(folder: Path) -> Iterator[str]:
    with served("file_server.py", folder) as port:
        yield f"http://127.0.0.1:{port}"


@pytest.fixture(scope="module")
def s3_port(folder: Path) -> Iterator[int]:
    import boto3

    with served("s3_server.py") as port:
        client = boto3.client(
            "s3",
            endpoint_url=f"http://127.0.0.1:{port}",
            aws_access_key_id="id",
            aws_secret_access_key="key",  # noqa: S106
            region_name="us-east-1",
        )
        client.create_bucket(Bucket=BUCKET)
        client.upload_file(str(folder / "long.mcap"), BUCKET, "june/long.mcap")
        client.put_object(Bucket=BUCKET, Key="june/bag/")  # as some tools make for a folder
        for path in (folder / "bag").iterdir():
            client.upload_file(str(path), BUCKET, f"june/bag/{path.name}")
        client.close()
        yield port


@pytest.fixture
def s3(s3_port: int, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{s3_port}")
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "id")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "key")
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    return f"s3://{BUCKET}/june/long.mcap"


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote_file, "_RETRY_AFTER_S", (0.01,))


def test_a_window_of_a_web_file_costs_its_chunks(web: str, folder: Path) -> None:
    path = folder / "long.mcap"
    before = int(urlopen(f"{web}/sent").read())  # noqa: S310
    assert_equal_to_the_file(f"{web}/files/long.mcap", path, WINDOW)
    sent = int(urlopen(f"{web}/sent").read()) - before  # noqa: S310
    assert 0 < sent <= needed_bytes(path) < path.stat().st_size / 2


@pytest.mark.slow
def test_a_window_of_an_s3_object_costs_its_chunks(s3: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from s3fs.core import S3File

    assert_a_window_costs_its_chunks(S3File, s3, folder / "long.mcap", monkeypatch)


@pytest.mark.in_turn
def test_inspect_reads_it_too(s3: str) -> None:
    summary = inspect_source(s3, config=WINDOW)
    assert summary.source == s3
    assert [cloud.frames for cloud in summary.clouds] == [150, 150]
    assert summary.objection == ""


@pytest.mark.slow
def test_a_bag_in_a_bucket_is_read_as_one(s3: str, folder: Path) -> None:
    bag = s3.replace("long.mcap", "bag/")
    assert_equal_to_the_file(bag, folder / "bag", IngestConfig(frames=3))
    assert read_snapshot(bag).source_sha256 == read_snapshot(folder / "bag").source_sha256
    assert identify_log(bag) == identify_log(folder / "bag")
    assert identify_log(bag).vehicle == "bus 7"


@pytest.mark.usefixtures("s3")
@pytest.mark.slow
@pytest.mark.in_turn
def test_a_bag_in_a_bucket_is_one_log_of_a_fleet(folder: Path) -> None:
    listed = [
        [log.source for log in find_logs([f"s3://{BUCKET}/{given}"])]
        for given in ("", "june/bag", "june/*", "june/*/*", "june/bag/*.db3*")
    ]
    bag, file, part = (f"s3://{BUCKET}/june/{name}" for name in ("bag/", "long.mcap", "bag/bag.db3"))
    assert listed == [[bag, file], [bag], [bag, file], [bag], [part]]
    log = next(find_logs([f"s3://{BUCKET}/june/"], LogPattern("{vehicle}/bag/")))
    assert log.vehicle == "june"
    assert log.size_bytes == sum(path.stat().st_size for path in (folder / "bag").iterdir())
    assert len(log.fingerprint) == 32


def test_the_hash_of_a_large_file_needs_only_its_ends(web: str, s3: str) -> None:
    hashes = {read_snapshot(url, config=WINDOW).source_sha256 for url in (f"{web}/files/long.mcap", s3)}
    assert len(hashes) == 1


@pytest.mark.parametrize("name", ["unindexed.mcap", "drive.bag"])
def test_what_cannot_be_read_by_ranges_is_copied(name: str, web: str, folder: Path) -> None:
    assert_equal_to_the_file(f"{web}/files/{name}", folder / name, IngestConfig(frames=3))


@pytest.mark.parametrize("name", ["long.mcap", "unindexed.mcap", "drive.bag"])
@pytest.mark.parametrize("kind", ["whole", "streamed"])
def test_a_server_of_whole_files_is_asked_for_the_whole_file(kind: str, name: str, web: str, folder: Path) -> None:
    assert_equal_to_the_file(f"{web}/{kind}/{name}", folder / name, IngestConfig(frames=3))


@pytest.mark.parametrize("kind", ["whole", "streamed"])
def test_a_large_file_is_not_taken_from_a_server_of_whole_files(
    kind: str, web: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(remote_file, "MAX_WHOLE_BYTES", 1 << 20)
    with pytest.raises(UnreadableSourceError, match=rf"/{kind}/long\.mcap has more than 0\.0 GB, and its server"):
        read_snapshot(f"{web}/{kind}/long.mcap")


def test_recorders_are_named_by_their_addresses(web: str) -> None:
    urls = [f"{web}/files/{name}" for name in ("long.mcap", "unindexed.mcap")]
    with pytest.raises(UsageError, match="both hold the LiDAR 'lidar_0'") as caught:
        read_snapshot(urls)
    assert str(caught.value).startswith(" and ".join(urls))


@pytest.mark.parametrize("name", ["drive.bag", "unindexed.mcap"])
def test_a_copy_is_made_once(name: str, web: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fetched: list[int] = []
    fetch = RemoteFile._fetch_once

    def counted(self: RemoteFile, start: int, end: int) -> bytes:
        fetched.append(end - start)
        return fetch(self, start, end)

    monkeypatch.setattr(RemoteFile, "_fetch_once", counted)
    for source in find_snapshots([f"{web}/files/{name}", f"{web}/files/{name}?again"]):
        read_snapshot(source.paths)
    assert sum(fetched) == 2 * (folder / name).stat().st_size


def test_copies_go_with_what_they_are_copies_of(web: str) -> None:
    file = RemoteFile(f"{web}/files/drive.bag")
    copy = file.copy("a bag")
    assert copy.is_file()
    assert file.copy("a bag") == copy
    del file
    gc.collect()
    assert not copy.parent.exists()


def test_a_copy_is_not_made_of_a_large_file(web: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote_file, "MAX_WHOLE_BYTES", 1000)
    with pytest.raises(UnreadableSourceError, match="a ROS 1 bag can only be read as a whole"):
        read_snapshot(f"{web}/files/drive.bag")


def test_a_copy_bears_the_name_of_the_original(web: str, folder: Path) -> None:
    (folder / "torn.bag").write_bytes((folder / "drive.bag").read_bytes()[:200])
    with pytest.raises(UnreadableSourceError, match=r"^http://127\.0\.0\.1:\d+/files/torn\.bag is damaged"):
        read_snapshot(f"{web}/files/torn.bag")


def test_secrets_of_an_address_are_not_shown(web: str) -> None:
    secret = web.replace("http://", "http://fleet:hunter2@")
    snapshot = read_snapshot(f"{secret}/files/long.mcap?signature=hunter2#hunter2", config=WINDOW)
    assert snapshot.source == f"{web}/files/long.mcap"
    for place in ("denied/a.mcap", "files/none.mcap", "files/notes.txt", "busy/a.mcap"):
        with pytest.raises(MultilicaError) as caught:
            read_snapshot(f"{secret}/{place}?signature=hunter2")
        assert "hunter2" not in str(caught.value)


@pytest.mark.parametrize(
    ("place", "error", "text"),
    [
        ("files/none.mcap", SourceNotFoundError, "Nothing exists at"),
        ("denied/long.mcap", UnreadableSourceError, "Access to .* is denied"),
        ("busy/long.mcap", UnreadableSourceError, "status 503"),
        ("lost/long.mcap", UnreadableSourceError, "The connection to the server of .* failed"),
        ("files/notes.txt", UnreadableSourceError, "unknown format"),
    ],
)
def test_what_a_web_server_refuses_is_one_sentence(
    place: str, error: type[MultilicaError], text: str, web: str
) -> None:
    with pytest.raises(error, match=text) as caught:
        read_snapshot(f"{web}/{place}", config=WINDOW)
    assert str(caught.value).count("\n") == 0


def test_what_is_lost_once_is_asked_for_again(web: str, folder: Path) -> None:
    assert_equal_to_the_file(f"{web}/shaky/long.mcap", folder / "long.mcap", WINDOW)


def test_a_server_that_is_not_there_is_one_sentence() -> None:
    with pytest.raises(UnreadableSourceError, match="failed; check the address"):
        read_snapshot("http://127.0.0.1:9/long.mcap")


@pytest.mark.usefixtures("s3")
@pytest.mark.parametrize(
    ("place", "error", "text"),
    [
        (f"{BUCKET}/june/none.mcap", SourceNotFoundError, "Nothing exists at"),
        ("another-bucket/june/long.mcap", SourceNotFoundError, "Nothing exists at"),
        (f"{BUCKET}/june/bag", UnreadableSourceError, f"is a folder; .* s3://{BUCKET}/june/bag/ for a bag"),
        (f"{BUCKET}/july/", SourceNotFoundError, "Nothing exists at"),
    ],
)
def test_what_is_no_object_is_told(place: str, error: type[MultilicaError], text: str) -> None:
    with pytest.raises(error, match=text):
        read_snapshot(f"s3://{place}")


@pytest.mark.slow
def test_missing_credentials_are_told(s3: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    for name in ("AWS_SHARED_CREDENTIALS_FILE", "AWS_CONFIG_FILE"):
        monkeypatch.setenv(name, str(tmp_path / "none"))
    with pytest.raises(UnreadableSourceError, match="No credentials were found for s3://"):
        read_snapshot(s3)


@pytest.mark.parametrize(
    ("url", "module", "command"),
    [
        ("s3://logs/a.mcap", "s3fs", "pip install 'multilica[s3]'"),
        ("gs://logs/a.mcap", "gcsfs", "pip install 'multilica[gcs]'"),
    ],
)
def test_a_missing_package_is_named(url: str, module: str, command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.delitem(import_module("fsspec.registry")._registry, url[:2], raising=False)
    with pytest.raises(MissingDependencyError) as caught:
        read_snapshot(url)
    assert command in str(caught.value)


@pytest.mark.parametrize(
    "url", ["https://[::1/a.mcap", "https:///a.mcap", "http://h:99999/a.mcap", "s3://", "gs:///a.mcap", "ws://h:0"]
)
def test_addresses_that_are_not_valid_are_refused(url: str) -> None:
    with pytest.raises(UsageError, match=rf"^An address that begins with {url.partition(':')[0]}:// is not valid"):
        read_snapshot(url)


def test_an_address_made_into_a_path_is_told() -> None:
    with pytest.raises(UsageError, match=r"s3:/logs/a\.mcap was an address"):
        read_snapshot(Path("s3://logs/a.mcap"))


@pytest.mark.parametrize("url", ["ftp://a/b.mcap", "ws://127.0.0.1:8765"])
def test_other_addresses_are_refused(url: str) -> None:
    with pytest.raises(UsageError, match=url):
        read_snapshot(url)
