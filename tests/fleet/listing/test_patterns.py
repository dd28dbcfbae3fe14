# SPDX-License-Identifier: Apache-2.0
from datetime import UTC, datetime

import pytest

from multilica.errors import UsageError
from multilica.fleet.patterns import LogPattern

MARCH_NS = int(datetime(2026, 3, 1, 12, 30, tzinfo=UTC).timestamp()) * 10**9
DAY_NS = MARCH_NS - 45_000 * 10**9


@pytest.mark.parametrize(
    ("pattern", "source", "vehicle", "time"),
    [
        ("{vehicle}/{time:%Y-%m-%d_%H%M}", "logs/truck-7/2026-03-01_1230.mcap", "truck-7", MARCH_NS),
        ("/{vehicle}_{time:%Y%m%d%H%M}_*.bag", "x/v 1_202603011230_front.bag", "v 1", MARCH_NS),
        ("{time:%Y/%m/%d}", "2026/03/01/a.mcap", "", DAY_NS),
        ("cars/{vehicle}/", "logs/cars/v(1)/a.mcap", "v(1)", None),
        ("logs-*-{vehicle}/", "logs-{x}-v1/a.mcap", "v1", None),
    ],
)
def test_a_pattern_reads_paths(pattern, source, vehicle, time):
    assert LogPattern(pattern).of(source) == (vehicle, time)


@pytest.mark.parametrize(
    ("pattern", "source"),
    [("{vehicle}/{time:%Y-%m-%d}", "logs/2026-13-99.mcap"), ("cars/{vehicle}/", "trucks/v1/a.mcap")],
)
def test_a_pattern_does_not_fit_every_path(pattern, source):
    assert LogPattern(pattern).of(source) is None


@pytest.mark.parametrize("pattern", ["", "logs/*", "{vehicle}/{vehicle}", "{time:%Y-%B}", "{name}"])
def test_a_pattern_without_sense_is_refused(pattern):
    with pytest.raises(UsageError, match="pattern"):
        LogPattern(pattern)


@pytest.mark.parametrize(
    ("pattern", "words"),
    [
        ("{}/{vehicle}", r"Found \{\} in"),
        ("{name}/{vehicle}", r"Found \{name\} in"),
        ("{vehicle}/{time", r"Found \{ in"),
        ("{vehicle:%Y}}", r"Found \} in"),
        ("{vehicle}/{ time }", r"expected \{vehicle\} or \{time:%Y-%m-%d\}"),
    ],
)
def test_other_braces_are_told(pattern, words):
    with pytest.raises(UsageError, match=words):
        LogPattern(pattern)


@pytest.mark.parametrize(
    ("pattern", "source", "vehicle"),
    [
        ("{time:%Y-%m-%d}_{vehicle}", "logs/2026-03-01_bus1.mcap", "bus1"),
        ("{time}_{vehicle}", "logs/2026-03-01_bus.1.mcap.zst", "bus.1"),
        ("{time}/{vehicle}", "logs/2026-03-01/bus1.bag", "bus1"),
        ("{time}/{vehicle}", "logs/2026-03-01/bus1/drive.db3", "bus1"),
        ("{time}/{vehicle}", "s3://bucket/2026-03-01/bus1/", "bus1"),
        ("logs/{vehicle}", "logs/v1.2/drive.mcap", "v1.2"),
        ("logs/{vehicle}", "logs/v1.2", "v1.2"),
        ("{vehicle}", "bus1.db3", "bus1"),
        ("{vehicle}", "bus1/drive.mcap", "bus1"),
    ],
)
def test_a_vehicle_at_the_end_has_its_whole_name(pattern, source, vehicle):
    assert LogPattern(pattern).of(source) == (vehicle, DAY_NS if "time" in pattern else None)


@pytest.mark.parametrize("pattern", ["*{vehicle}/", "{vehicle}*.mcap", "{time}_{vehicle}*"])
def test_a_vehicle_without_an_end_is_refused(pattern):
    with pytest.raises(UsageError, match="expected a character between"):
        LogPattern(pattern)


@pytest.mark.parametrize(
    ("pattern", "source"),
    [
        ("{time:%Y%m%d}", "logs/SN99887766/20260301.mcap"),
        ("{time:%Y%m%d}", "logs/0012026030199/20260301.mcap"),
        ("_{time:%Y%m%d}", "logs/sn_20260230_20260301.mcap"),
        ("{time:%Y%m%d}*", "logs/20260301123000123.mcap"),
        ("SN9{time:%Y%m%d}", "logs/SN920260301.mcap"),
        ("{time:%Y%j}", "logs/2026366_2026060.mcap"),
    ],
)
def test_digits_of_other_numbers_are_no_time(pattern, source):
    assert LogPattern(pattern).of(source) == ("", DAY_NS)


@pytest.mark.parametrize("form", ["%m-%d", "%H%M%S", "%Y", "%Y-%m", "%d.%m", "%Y/%Y-%m-%d", "%y%Y%j"])
def test_a_time_without_a_date_is_refused(form):
    with pytest.raises(UsageError, match=r"expected a year \(%Y or %y\) with month and day"):
        LogPattern(f"{{vehicle}}/{{time:{form}}}")
