# SPDX-License-Identifier: Apache-2.0
"""The fleet's page as text: what it says, what it links, how large it is."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import UTC, datetime
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from multilica.extrinsics import Extrinsics
from multilica.fleet.drift.drift import find_drift, find_offsets, find_outages
from multilica.fleet.drift.findings import DriftEvent
from multilica.fleet.lidar_series import read_series
from multilica.fleet.report import page as page_module
from multilica.fleet.report.page import (
    PageFailure,
    PageVehicle,
    drawn_vehicles,
    fleet_page,
    store_report,
)
from multilica.fleet.store.query import FAILURES, STATUS, ask
from multilica.fleet.store.store import open_store
from multilica.geometry import RigidTransform
from tests.fleet.support.made_store import NOMINAL, SIGMA_DEG, SIGMA_MM, add_log, key_of, lidar_row, made_store
from tests.fleet.support.requests import DAY_NS, START_NS

TIMES = (START_NS + 121 * DAY_NS, START_NS + 151 * DAY_NS)
JUMP = DriftEvent(
    vehicle="v01",
    lidars=("front",),
    target="top",
    kind="jump",
    moved="lidar",
    key="b",
    time_ns=TIMES[1],
    last_before_key="a",
    last_before_time_ns=TIMES[0],
    last_key="b",
    last_time_ns=TIMES[1],
    translation_m=(0.0401, 0.0, 0.0),
    rotation_rad=(0.0, 0.0, 7e-5),
    p_value=1e-9,
)
HOSTILE = "</title><script>window.harmed = 1</script>\"'><img src=x onerror='window.harmed = 2'>\u202etxt\x1b"
SHOWN = "&lt;/title&gt;&lt;script&gt;window.harmed = 1&lt;/script&gt;"


def changed(event, **values):
    """The event with other values."""
    return event.model_copy(update=values)


def read_histories(store, vehicle):
    """The histories of the LiDARs of a vehicle."""
    return tuple(each for each in read_series(store) if each.vehicle == vehicle)


def renamed(series, name):
    """The history of a LiDAR, a target and logs with another name."""
    poses = tuple(replace(pose, target=name, source=name) for pose in series.T_target_lidar)
    return replace(series, lidar=name, target=name, T_target_lidar=poses, sources=(name,) * len(series))


class Tables(HTMLParser):
    """Cells by class of their table, links, and counts of elements."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.rows: dict[str, list[list[str]]] = {}
        self.links: list[str] = []
        self.opened: list[tuple[str, dict[str, str | None]]] = []
        self._table, self._cell = "", False
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.opened.append((tag, values))
        if tag == "table":
            self._table = (values["class"] or "").split()[-1]
            self.rows[self._table] = []
        elif tag == "tr":
            self.rows[self._table].append([])
        elif tag in ("td", "th"):
            self.rows[self._table][-1].append("")
            self._cell = True
        elif tag == "a":
            self.links.append(values["href"] or "")

    def handle_endtag(self, tag):
        self._cell = self._cell and tag not in ("td", "th")

    def handle_data(self, data):
        if self._cell:
            self.rows[self._table][-1][-1] += data

    def body(self, table: str) -> list[list[str]]:
        return [[" ".join(cell.split()) for cell in row] for row in self.rows[table][1:]]


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return made_store(tmp_path_factory.mktemp("fleet"))


@pytest.fixture(scope="module")
def text(store, tmp_path_factory):
    return store_report(store, tmp_path_factory.mktemp("elsewhere") / "page.html")


def test_the_overview_has_the_numbers_of_the_tables(store, text):
    with ask(store, STATUS) as answer:
        expected = [
            [row[0], *(str(each or "-") for each in (row[1], f"{row[2]:%Y-%m-%d}", f"{row[3]:%Y-%m-%d}", *row[4:8]))]
            for row in answer.rows()
        ]
    rows = Tables(text).body("overview")
    assert [row[:8] for row in rows] == expected
    assert [row[8] for row in rows] == ["front: jump", "rear: lost rear: dead_sensor", "-"]
    with ask(store, "SELECT count(*), count(*) FILTER (state = 'verified') FROM logs") as answer:
        ((logs, verified),) = answer.rows()
    assert f"{logs} logs from 2026-01-02 to 2026-10-01: {verified} verified, 6 calibrated, 1 without a result." in text
    assert "<h1>1 LiDAR moved on 1 of 3 vehicles.</h1>" in text
    assert "1 LiDAR has no certain pose in the last log of its vehicle." in text


def test_the_lines_show_the_largest_distance_to_the_median(store, text):
    histories = read_histories(store, "v01")
    assert [each.lidar for each in histories] == ["front", "rear"]
    lengths = [np.linalg.norm(each.offsets_from_median().reshape(-1, 2, 3), axis=2) for each in histories]
    assert lengths[0][:, 0].max() == pytest.approx(40.0, abs=25.0)
    (row,) = [row for row in Tables(text).body("overview") if row[0] == "v01"]
    assert row[9] == f"{lengths[0][:, 0].max():.0f} mm front"
    assert row[10].split()[0] == f"{max(each[:, 1].max() for each in lengths):.2f}"


def test_the_failures_are_those_of_the_command(store, text):
    with ask(store, FAILURES) as answer:
        expected = sorted(row[6] for row in answer.rows())
    tables = Tables(text)
    assert sorted(row[3] for row in tables.body("failures")) == expected
    assert tables.body("causes") == [["dead_sensor", "", "-", "2"], ["unreadable", "", "1", "-"]]
    _, lost, broken = tables.body("failures")
    assert lost[:3] == ["v02", "2026-09-30", "rear: dead_sensor"]
    assert broken[1:] == ["no time", "unreadable", "v03/broken.bag is empty.", "v03/broken.bag"]
    with ask(store, "SELECT recording FROM logs WHERE source = 'v02/272.mcap'") as answer:
        ((recording,),) = answer.rows()
    assert lost[4] == f"v02/272.mcap{recording}"
    assert [link for link in tables.links if not link.startswith("#")] == []


def test_events_are_those_of_the_drift_command(store, text):
    (event,) = find_drift(list(read_series(store)))
    (outage,) = find_outages(store)
    size = f"{1e3 * np.linalg.norm(event.translation_m):.1f} mm, {np.rad2deg(np.linalg.norm(event.rotation_rad)):.2f}°"
    assert Tables(text).body("events") == [
        ["v01", "front", "jump", "2026-06-01", size, event.sentence],
        ["v02", "rear", "lost", "since 2026-08-31", "-", outage.sentence],
    ]
    assert 38.0 < float(size.split(maxsplit=1)[0]) < 42.0


def test_an_event_leads_to_its_vehicle(text):
    tables = Tables(text)
    opened = [values for tag, values in tables.opened if tag == "details"]
    assert ["open" in values for values in opened] == [True, True, False]
    anchors = {values["id"] for _, values in tables.opened if "id" in values}
    assert {link[1:] for link in tables.links} <= anchors
    for label in ("jump 2026-06-01", "lost since 2026-08-31"):
        assert text.count(f"{label}</text>") == 2  # in both plots of the LiDAR
    assert text.count('<path class="event jump"') == text.count('<rect class="span jump"') == 2


@pytest.mark.slow
def test_a_vehicle_unlike_the_others_is_told(tmp_path):
    store = open_store(tmp_path, create=True)
    for number in range(6):
        for day in range(4):
            shift_mm = (0.1 * number - 0.1 * day, 0.1 * day, 120.0 * (number == 5))
            add_log(store, f"v{number}", day, lambda *log, s=shift_mm: [lidar_row(*log, "rear", shift_mm=s)])
    (event,) = find_offsets(list(read_series(store)))
    assert (event.vehicle, event.kind, event.when, event.period_ns) == ("v5", "offset", "", None)
    text = store_report(store, tmp_path / "page.html")
    assert Tables(text).body("events") == [
        ["v5", "rear", "offset", "all logs", f"{event.size[0]:.1f} mm, 0.00°", event.sentence]
    ]
    assert "1 LiDAR sits elsewhere than on the other vehicles." in text
    assert "<h1>No LiDAR moved on 6 vehicles.</h1>" in text


@pytest.mark.slow
@pytest.mark.parametrize(("vehicles", "whose"), [(3, ["all vehicles"]), (2, ["v0", "v1"])])
def test_a_wrong_design_is_told_with_nominal_poses(vehicles, whose, tmp_path):
    store = open_store(tmp_path / "store", create=True)
    for number in range(vehicles):
        for day in range(4):
            shift_mm = (0.1 * number - 0.1 * day, 0.1 * day, 0.0)
            add_log(store, f"v{number}", day, lambda *log, s=shift_mm: [lidar_row(*log, "rear", shift_mm=s)])
    xyz_m, rpy_deg = NOMINAL["rear"]
    designed = RigidTransform.from_xyz_rpy("top", "rear", np.add(xyz_m, (0.0, 0.0, 0.2)), np.deg2rad(rpy_deg))
    nominal = Extrinsics("top", {"rear": designed})
    text = store_report(store, tmp_path / "page.html", nominal)
    rows = Tables(text).body("events")
    assert [row[:4] for row in rows] == [[name, "rear", "offset", "all logs"] for name in whose]
    assert [row[5] for row in rows] == [each.sentence for each in find_offsets(list(read_series(store)), nominal)]
    assert all(row[4].startswith("200.") or row[4].startswith("199.") for row in rows)
    count = "1 LiDAR sits" if len(whose) == 1 else "2 LiDARs sit"
    assert f"{count} elsewhere than designed." in text
    assert "elsewhere than on the other vehicles" not in text
    assert "designed" not in store_report(store, tmp_path / "page.html")


def test_marks_tell_verified_from_calibrated_and_lost(text):
    section = text[text.index('id="vehicle-2"') : text.index('id="vehicle-3"')]
    rear = section[section.index("<h4>rear") : section.index("<h4>front")]  # with its event, it comes first
    assert [each.count("M") for each in re.findall(r'class="ring" d="([^"]*)"', rear)] == [7] * 6
    assert [each.count("M") for each in re.findall(r'class="diamond" d="([^"]*)"', rear)] == [1] * 6
    assert [each.count("M") for each in re.findall(r'class="missing" d="([^"]*)"', rear)] == [2, 2]
    assert "2026-01-03, calibrated: x " in rear


def test_offsets_and_sigmas_are_in_mm_and_deg(tmp_path):
    store = open_store(tmp_path, create=True)
    moves = [
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ((5.0, -6.0, 7.0), (0.1, -0.2, 0.3)),
        ((-1.0, 1.0, -1.0), (-0.1, 0.1, -0.1)),
    ]
    for day, (shift_mm, turn_deg) in enumerate(moves):
        add_log(store, "v", day, lambda *log, s=shift_mm, t=turn_deg: [lidar_row(*log, "rear", shift_mm=s, turn_deg=t)])
    add_log(store, "v", None, lambda *log: [lidar_row(*log, "rear")])
    (history,) = read_histories(store, "v")
    assert history.offsets_from_median() == pytest.approx(
        np.array([[*shift, *turn] for shift, turn in moves]), abs=2e-3
    )
    assert history.sigmas() == pytest.approx(np.tile([*SIGMA_MM, *SIGMA_DEG], (3, 1)))
    assert history.undated == 1


@pytest.mark.slow
def test_recordings_are_linked_from_within_the_store(store):
    (path,) = [link for link in Tables(store_report(store, Path(store.root) / "page.html")).links if link[0] != "#"]
    assert path == f"./runs/v02/2026-09/{key_of('v02/272.mcap')}/recording.rrd"
    below = Path(store.root) / "runs" / "page.html"
    (path,) = [link for link in Tables(store_report(store, below)).links if link[0] != "#"]
    assert path.startswith("../runs/v02/2026-09/")


@pytest.mark.slow
def test_a_recording_that_was_pruned_is_not_linked(tmp_path):
    store = made_store(tmp_path)
    for path, _ in list(store.files("runs")):
        store.remove(path)
    text = store_report(store, tmp_path / "page.html")
    assert [link for link in Tables(text).links if link[0] != "#"] == []
    assert "recording.rrd" not in text


def test_a_link_finds_a_folder_with_percent_signs():
    failure = PageFailure("a/b", None, "s", "", "failed", "unreadable", "t", "runs/a%2Fb/recording.rrd")
    text = fleet_page("store", [PageVehicle("a/b", 1, None, None, 0, 0, 1, 0)], [], [failure], ".")
    assert './runs/a%252Fb/recording.rrd"' in text


def test_names_cannot_leave_the_text(store):
    (history, _) = read_histories(store, "v01")
    history = renamed(history, HOSTILE)
    vehicle = PageVehicle(HOSTILE, 1, None, None, 1, 0, 1, 0, (HOSTILE,), (history,))
    event = changed(JUMP, vehicle=HOSTILE, lidars=(HOSTILE,))
    failure = PageFailure(HOSTILE, None, HOSTILE, HOSTILE, "failed", HOSTILE, HOSTILE, HOSTILE)
    for files in (None, ".", ".."):
        text = fleet_page(HOSTILE, [vehicle], [event], [failure], files)
        opened = [tag for tag, _ in Tables(text).opened]
        assert opened.count("script") == 1
        assert opened.count("title") == 1 + 2 * len(history.sources)
        assert "img" not in opened
        assert not {attribute for _, values in Tables(text).opened for attribute in values if attribute[:2] == "on"}
        assert not re.search("[\u202e\x1b]", text)
        assert text.count(SHOWN) > 10
        assert "\\u202etxt\\x1b" in text


def test_a_page_asks_for_nothing(text):
    tables = Tables(text)
    addresses = [
        values[key] for _, values in tables.opened for key in ("src", "href", "srcset", "action") if key in values
    ]
    assert [address for address in addresses if not address.startswith("#")] == []
    assert re.findall(r"url\(|@import| style=", text) == []


def test_an_empty_store_has_a_page(tmp_path):
    text = store_report(open_store(tmp_path / "store", create=True), tmp_path / "page.html")
    assert "<h1>No logs yet.</h1>" in text
    assert "The store has no logs yet." in text


def _fleet(store, count):
    """Vehicles with the histories of one."""
    histories = read_histories(store, "v01")
    day = datetime(2026, 1, 2, tzinfo=UTC)
    return [PageVehicle(f"v{number}", 10, day, day, 8, 2, 0, 0, (), histories) for number in range(count)]


def test_a_fleet_of_twenty_vehicles_fits_into_a_mail(store):
    vehicles = [replace(vehicle, histories=(*vehicle.histories, vehicle.histories[0])) for vehicle in _fleet(store, 20)]
    events = [changed(JUMP, vehicle=vehicle.name) for vehicle in vehicles]
    text = fleet_page("store", vehicles, events, [])
    assert text.count("<title>") > 20 * 3 * 2 * 9
    assert len(text.encode()) < 2_000_000


def test_of_a_large_fleet_the_urgent_ones_are_drawn(store):
    names = [f"v{number}" for number in range(300)]
    failure = PageFailure("v7", None, "s", "", "failed", "unreadable", "t")
    event = changed(JUMP, vehicle="v250")
    assert drawn_vehicles(names, [event], [failure]) == ["v250", "v7"]
    assert drawn_vehicles(names[:200], [], [failure])[:3] == ["v7", "v0", "v1"]
    assert len(drawn_vehicles(names, [changed(JUMP, vehicle=name) for name in names], [])) == 200
    vehicles = [
        vehicle if vehicle.name in ("v250", "v7") else replace(vehicle, histories=()) for vehicle in _fleet(store, 300)
    ]
    text = fleet_page("store", vehicles, [event], [failure])
    assert "2 of 300 vehicles are drawn, those with events and failures first." in text
    assert [text.count(f">{name}</h3>") for name in ("v250", "v7", "v8")] == [1, 1, 0]


def test_a_page_that_is_too_large_loses_texts_then_plots(store, monkeypatch):
    vehicles = _fleet(store, 4)
    whole = fleet_page("store", vehicles, [changed(JUMP, vehicle="v3")], [])
    monkeypatch.setattr(page_module, "MAX_BYTES", len(whole.encode()) - 1)
    lean = fleet_page("store", vehicles, [changed(JUMP, vehicle="v3")], [])
    assert (lean.count("<title>"), lean.count("<details")) == (1, 4)
    monkeypatch.setattr(page_module, "MAX_BYTES", len(lean.encode()) - 1)
    short = fleet_page("store", vehicles, [changed(JUMP, vehicle="v3")], [])
    assert short.count("<details") == 2
    assert ">v3</h3>" in short
