# SPDX-License-Identifier: Apache-2.0
import os
from datetime import UTC, datetime

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from fsspec.implementations.dirfs import DirFileSystem

from multilica.errors import SourceNotFoundError, UnreadableSourceError, UsageError
from multilica.fleet import listing
from multilica.fleet.listing import find_logs
from multilica.fleet.patterns import LogPattern
from multilica.fleet.store.store import open_store
from tests.fleet.support.listed import sources, write_files

MARCH_NS = int(datetime(2026, 3, 1, 12, 30, tzinfo=UTC).timestamp()) * 10**9


@pytest.fixture
def folder(tmp_path):
    write_files(tmp_path / "logs", "v1/a.mcap", "v1/.hidden.mcap", "v1/notes.txt", "v2/b.bag", "v2/c/d.db3")
    write_files(tmp_path / "logs", "v2/bag/metadata.yaml", "v2/bag/x_0.mcap", "v2/bag/x_1.mcap", "v2/scans/left.pcd")
    return tmp_path


def test_a_folder_is_searched_to_its_ends_and_a_bag_is_one_log(folder):
    logs = list(find_logs([str(folder / "logs")]))
    names = ["logs/v1/a.mcap", "logs/v2/b.bag", "logs/v2/bag", "logs/v2/c/d.db3", "logs/v2/scans"]
    assert [log.source for log in logs] == names
    assert [log.address for log in logs] == [str(folder / name) for name in names]
    assert logs[0].size_bytes == len("v1/a.mcap")
    assert logs[2].size_bytes > 40
    assert len({log.fingerprint for log in logs}) == 5


def test_what_is_no_file_is_passed_over(folder):
    os.mkfifo(folder / "logs/v1/pipe.mcap")
    (folder / "logs/v1/deep").mkdir()
    (folder / "logs/v1/deep/up").symlink_to("..")
    (folder / "logs/v1/self").symlink_to(".")
    (folder / "logs/v1/gone.mcap").symlink_to("nowhere")
    assert [log.source for log in find_logs([str(folder / "logs/v1")])] == ["v1/a.mcap", "v1/gone.mcap"]
    assert [log.source for log in find_logs([str(folder / "logs/v1/*.mcap")])] == ["v1/a.mcap"]
    with pytest.raises(UnreadableSourceError, match="neither a file nor a folder"):
        list(find_logs([str(folder / "logs/v1/pipe.mcap")]))


def test_the_source_does_not_depend_on_where_the_logs_lie(folder, monkeypatch):
    monkeypatch.chdir(folder / "logs")
    wanted = next(iter(find_logs([str(folder / "logs" / "v1")])))
    for given in ("v1", "./v1/", "v1/a.mcap", "v1/*.mcap", str(folder / "logs" / "v?" / "a.mcap")):
        (found,) = find_logs([given])
        assert found.source in {"v1/a.mcap", "logs/v1/a.mcap"}
        assert found.fingerprint == wanted.fingerprint
        assert found.address.endswith(found.source)


def test_the_fingerprint_follows_the_content(folder):
    before = next(iter(find_logs([str(folder / "logs" / "v1")])))
    (folder / "logs/v1/a.mcap").write_bytes(b"x" * 3_000_000)
    middle = next(iter(find_logs([str(folder / "logs" / "v1")])))
    (folder / "logs/v1/a.mcap").write_bytes(b"x" * 2_999_999 + b"y")
    end = next(iter(find_logs([str(folder / "logs" / "v1")])))
    assert len({before.fingerprint, middle.fingerprint, end.fingerprint}) == 3


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_a_manifest_gives_vehicle_and_time(folder, form):
    rows = {
        "source": ["logs/v1/a.mcap", str(folder / "logs/v2/b.bag"), "s3://bucket/x/c.mcap", "logs/none.mcap"],
        "vehicle": ["truck 7", "", "../v3", "v4"],
        "time": ["2026-03-01T12:30:00Z", "", "1772368200", "2026-03-01T13:30:00+01:00"],
        "driver": ["unused"] * 4,
    }
    path = folder / f"manifest.{form}"
    if form == "csv":
        lines = [",".join(rows), *(",".join(values) for values in zip(*rows.values(), strict=True))]
        path.write_text("\n".join(lines) + "\n")
    else:
        rows["time"] = [datetime.fromtimestamp(MARCH_NS / 1e9, UTC), None] + [
            datetime.fromtimestamp(MARCH_NS / 1e9, UTC)
        ] * 2
        pq.write_table(pa.table(rows), path)
    one, two, three, four = find_logs([str(path)])
    assert [each.source for each in (one, two, three, four)] == [
        "logs/v1/a.mcap",
        "v2/b.bag",
        "s3://bucket/x/c.mcap",
        "logs/none.mcap",
    ]
    assert [each.vehicle for each in (one, two, three, four)] == ["truck 7", "", "../v3", "v4"]
    assert [each.time_ns for each in (one, two, three, four)] == [MARCH_NS, None, MARCH_NS, MARCH_NS]
    assert one.address == str(folder / "logs/v1/a.mcap")
    assert one.size_bytes > 0 == four.size_bytes


def test_logs_that_a_pattern_does_not_fit_are_counted(folder):
    unlike = []
    logs = list(find_logs([str(folder / "logs")], LogPattern("{vehicle}/a"), unlike.append))
    assert [(log.source, log.vehicle) for log in logs if log.vehicle] == [("logs/v1/a.mcap", "v1")]
    assert [log.source for log in unlike] == [log.source for log in logs if not log.vehicle]
    assert len(unlike) == 4


def test_a_pattern_that_fits_no_log_is_refused(folder):
    with pytest.raises(UsageError, match=r"'cars/\{vehicle\}/' fits no log; the first of them is logs/v1/a\.mcap"):
        list(find_logs([str(folder / "logs")], LogPattern("cars/{vehicle}/")))
    (folder / "none").mkdir()
    assert list(find_logs([str(folder / "none")], LogPattern("cars/{vehicle}/"))) == []


def test_point_files_beside_recordings_are_no_log(tmp_path):
    logs = write_files(
        tmp_path / "logs", "all.ply", "bus1/a.mcap", "bus1/map.pcd", "bus2/scans/left.pcd", "bus2/rig.ply"
    )
    assert sources(logs) == ["logs/bus1/a.mcap", "logs/bus2"]
    write_files(logs, "bus2/rig/bag/metadata.yaml")
    assert sources(logs) == ["logs/bus1/a.mcap", "logs/bus2/rig/bag", "logs/bus2/scans"]


def test_the_results_of_runs_are_no_logs(tmp_path):
    logs = write_files(tmp_path / "logs", "a.mcap", "b/result.mcap", "one/result.mcap", "one/result.json")
    write_files(logs, "two/result.partial.mcap", "two/recording.partial.rrd", "fleet.json")
    store = open_store(logs / "store", create=True)
    store.write(f"runs/v1/2026-03/{'0' * 32}/result.mcap", b"")
    assert sources(logs) == sources(logs / "**/*.mcap") == ["logs/a.mcap", "logs/b/result.mcap"]
    assert sources(logs / "s*") == sources(logs / "store/*") == sources(logs / "store") == []
    assert sources(logs / "one/result.mcap") == ["one/result.mcap"]


def test_results_in_a_bucket_are_no_logs(tmp_path, monkeypatch):
    stored = f"logs/store/runs/v1/2026-03/{'0' * 32}/result.mcap"
    write_files(tmp_path / "bucket", stored, "logs/run/result.mcap", "logs/run/result.json", "logs/b/result.mcap")
    disk = DirFileSystem(str(tmp_path))
    monkeypatch.setattr(listing, "open_file_system", lambda url: (disk, url.removeprefix("s3://")))
    assert sources("s3://bucket/logs") == ["s3://bucket/logs/b/result.mcap"]
    with pytest.raises(SourceNotFoundError, match="There is no recording"):
        sources("s3://bucket/logs/store/runs/*/*/*/result.mcap")


def test_a_bag_given_itself_has_the_name_of_its_folder(folder, monkeypatch):
    bag, scans = folder / "logs/v2/bag", folder / "logs/v2/scans"
    wanted = ["v2/bag", "v2/scans"]
    assert sources(bag, scans) == wanted
    monkeypatch.chdir(bag)
    assert sources(".", "../scans") == sources("../bag/", scans) == wanted
    assert [log.address for log in find_logs([".", "../scans/."])] == [str(bag), f"{bag}/../scans"]


def test_nothing_is_told(tmp_path):
    with pytest.raises(UsageError, match="No logs were given"):
        list(find_logs([]))
    with pytest.raises(SourceNotFoundError, match="Nothing exists"):
        list(find_logs([str(tmp_path / "none")]))
    with pytest.raises(SourceNotFoundError, match="No file matches"):
        list(find_logs([str(tmp_path / "*.mcap")]))
    with pytest.raises(UsageError, match="unknown kind"):
        list(find_logs(["ftp://host/log.mcap"]))
