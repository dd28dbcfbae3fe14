# SPDX-License-Identifier: Apache-2.0
import sys
from datetime import UTC, date, datetime

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from multilica.errors import UnreadableSourceError
from multilica.fleet.manifest import ManifestRow, read_manifest

DAY_NS = int(datetime(2026, 3, 1, tzinfo=UTC).timestamp()) * 10**9


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "cannot be read as CSV"),
        ("path,vehicle\na,b\n", "has the columns path, vehicle; expected source"),
        ("source,time\na.mcap,yesterday\n", "has the time 'yesterday'"),
        ("source,vehicle\n,v1\n", "has no source"),
        ("source,time\na.mcap,12345678901234567890123\n", "has the time"),
    ],
)
def test_a_manifest_that_cannot_be_used_is_refused(tmp_path, content, words):
    (tmp_path / "logs.csv").write_text(content)
    with pytest.raises(UnreadableSourceError, match=words):
        list(read_manifest(tmp_path / "logs.csv"))


def csv_of(folder, *lines):
    path = folder / "logs.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def parquet_of(folder, **columns):
    path = folder / "logs.parquet"
    pq.write_table(pa.table(columns), path)
    return path


def test_names_of_a_csv_file_stay_as_they_are(tmp_path):
    path = csv_of(tmp_path, "source,vehicle,note", "1,007,a", "02,0,b", "c,1e3,c", "d,,d")
    rows = [ManifestRow(*row, None) for row in [("1", "007"), ("02", "0"), ("c", "1e3"), ("d", "")]]
    assert list(read_manifest(path)) == rows


@pytest.mark.parametrize(
    ("vehicles", "names"),
    [(pa.array([0, 7]), ["0", "7"]), (pa.array([7.0, None]), ["7", ""]), (pa.array([None, None]), ["", ""])],
)
def test_numbers_of_a_parquet_file_are_names(tmp_path, vehicles, names):
    path = parquet_of(tmp_path, source=pa.array(["a", "b"]).dictionary_encode(), vehicle=vehicles)
    assert [row.vehicle for row in read_manifest(path)] == names


@pytest.mark.parametrize(
    "text",
    [
        "1772323200",
        "1772323200000",
        "1772323200000000",
        "1772323200000000000",
        "1772323200.0",
        "1.7723232E+12",
        "20260301",
        "2026-03-01",
        " 2026-03-01T02:00:00+02:00",
        "20260301T000000Z",
    ],
)
def test_a_time_of_a_manifest_has_any_unit(tmp_path, text):
    assert [row.time_ns for row in read_manifest(csv_of(tmp_path, "source,time", f"a,{text}", "b,"))] == [DAY_NS, None]


@pytest.mark.parametrize(
    "times",
    [
        pa.array([DAY_NS // 1000, None], pa.timestamp("us")),
        pa.array([DAY_NS // 10**9, None], pa.timestamp("s")),
        pa.array([date(2026, 3, 1), None]),
        pa.array([DAY_NS // 10**6, None]),
        pa.array([DAY_NS / 1e9, None]),
        pa.array([20260301, None]),
    ],
)
def test_times_of_a_parquet_file_have_any_type(tmp_path, times):
    path = parquet_of(tmp_path, source=["a", "b"], time=times)
    assert [row.time_ns for row in read_manifest(path)] == [DAY_NS, None]


@pytest.mark.parametrize("kind", [pa.timestamp("ns"), pa.timestamp("ns", tz="Asia/Tokyo"), pa.int64()])
def test_nanoseconds_need_no_other_library(tmp_path, kind, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    path = parquet_of(tmp_path, source=["a", "b"], time=pa.array([DAY_NS + 789, None], kind))
    assert [row.time_ns for row in read_manifest(path)] == [DAY_NS + 789, None]


@pytest.mark.parametrize(
    "text", ["7", "0", "-1772323200", "2026", "20261301", "202603011230", "20260301123000", "1e99", "nan", "0001-01-01"]
)
def test_a_number_that_is_no_time_is_refused(tmp_path, text):
    with pytest.raises(UnreadableSourceError, match=r"has the time '.*'; expected ISO 8601, YYYYMMDD, or a number"):
        list(read_manifest(csv_of(tmp_path, "source,time", f"a,{text}")))


@pytest.mark.parametrize(
    ("name", "values", "words"),
    [
        ("vehicle", [["v1"]], "column vehicle of the manifest .* is of the type list<.*; expected text"),
        ("time", [[1]], "column time of the manifest"),
        ("time", [True], "has the time 'true'"),
        ("time", [datetime(9999, 1, 1)], "expected the years 1678 to 2262"),  # noqa: DTZ001 - as it is written
    ],
)
def test_a_type_that_does_not_fit_is_told(tmp_path, name, values, words):
    with pytest.raises(UnreadableSourceError, match=words):
        list(read_manifest(parquet_of(tmp_path, source=["a"], **{name: values})))
