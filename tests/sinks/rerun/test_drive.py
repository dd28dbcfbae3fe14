# SPDX-License-Identifier: Apache-2.0
"""The stops of a drive in a recording."""

from __future__ import annotations

import numpy as np
import pytest

from multilica.config import RecordConfig
from multilica.sinks.rerun.blueprint import final_blueprint
from multilica.sinks.rerun.scene import limits_for
from multilica.sinks.rerun.views import above_drive
from multilica.sinks.run_state import RunState
from multilica.snapshot import LidarScans, Scan, Snapshot
from tests.sinks.conftest import record
from tests.sinks.made_drive import FIRST, LINKS, STOPS
from tests.sinks.made_events import LIDARS, TARGET, TRUTH, made_events
from tests.sinks.recording_reader import Recording

COUNTS = {stop.name: 1200 // number for number, stop in enumerate(STOPS, start=1)}


def cloud_path(stop, lidar):
    name = lidar.replace(" ", r"\ ").replace("/", r"\/")
    return f"/drive/{FIRST}/stops/{stop}/lidars/{name}"


def frames_of(recording, path):
    rows = recording.rows(path)
    (row,) = [row for row in rows if row.get("Transform3D:translation")]
    names = (row[f"Transform3D:{end}_frame"][0] for end in ("parent", "child"))
    return (*names, np.array(row["Transform3D:translation"][0]))


@pytest.fixture(scope="module")
def recording(recordings):
    return Recording(recordings["drive"])


def test_the_vehicle_is_at_the_pose_of_each_stop(recording):
    for stop in STOPS:
        parent, child, xyz_m = frames_of(recording, f"/drive/{FIRST}/stops/{stop.name}")
        assert (parent, child) == (f"lidar/{TARGET}", f"stop/{stop.name}")
        np.testing.assert_allclose(xyz_m, stop.T_first_stop.xyz_m, atol=1e-5)
        assert recording.last(f"/drive/{FIRST}/stops/{stop.name}/name", "Points3D:labels") == [stop.name]


@pytest.mark.parametrize("lidar", LIDARS)
def test_clouds_are_where_the_lidars_are_on_the_vehicle(recording, lidar):
    for stop in STOPS:
        parent, child, xyz_m = frames_of(recording, cloud_path(stop.name, lidar))
        assert (parent, child) == (f"stop/{stop.name}", f"stop/{stop.name}/{lidar}")
        np.testing.assert_allclose(xyz_m, TRUTH[lidar].xyz_m, atol=1e-5)
        assert len(recording.last(cloud_path(stop.name, lidar), "Points3D:positions")) == COUNTS[stop.name]


def test_the_timeline_of_stops_shows_one_at_a_time(recording):
    for number in (1, 2, 3):
        shown = {}
        for stop in STOPS:
            rows = [row for row in recording.rows(cloud_path(stop.name, "rear")) if row.get("stop") is not None]
            known = [row for row in rows if row["stop"] <= number and row.get("Points3D:positions") is not None]
            latest = max(known, key=lambda row: row["stop"], default={"Points3D:positions": []})
            shown[stop.name] = len(latest["Points3D:positions"])
        assert shown == {stop.name: COUNTS[stop.name] * (stop is STOPS[number - 1]) for stop in STOPS}


def test_without_the_timeline_of_stops_all_are_shown(recording):
    for stop in STOPS:
        rows = [row for row in recording.rows(cloud_path(stop.name, "top")) if row.get("step") is not None]
        assert [len(row["Points3D:positions"]) for row in rows if row.get("Points3D:positions")] == [COUNTS[stop.name]]


def test_links_go_from_lidar_to_lidar(recording):
    poses = {stop.name: stop.T_first_stop for stop in STOPS}
    for used, name in ((True, "used"), (False, "unused")):
        expected = [
            [
                poses[link.target_stop].apply(TRUTH[link.target].xyz_m[None])[0],
                poses[link.source_stop].apply(TRUTH[link.source].xyz_m[None])[0],
            ]
            for link in LINKS
            if link.used == used
        ]
        strips = recording.last(f"/drive/{FIRST}/links/{name}", "LineStrips3D:strips")
        np.testing.assert_allclose(strips, expected, atol=1e-5)


def test_without_linked_stops_there_is_no_drive(recordings):
    assert not [path for path in Recording(recordings["complete"]).entity_paths if path.startswith("/drive")]


def tabs(outcome, *, at_stops=True):
    state = RunState()
    for event in made_events(outcome, at_stops=at_stops):
        state(event)
    root = final_blueprint(state).root_container
    return [tab.name for tab in root.contents], root.contents[root.active_tab].name


def test_the_drive_is_beside_the_result():
    names, opened = tabs("complete")
    assert names[:2] == ["Result", "Drive"]
    assert opened == "Result"
    names, opened = tabs("partial")
    assert names[1:3] == ["Result", "Drive"]
    assert opened == "Not placed: rear"
    assert "Drive" not in tabs("complete", at_stops=False)[0]


def test_the_camera_looks_down_on_all_stops():
    state = RunState()
    for event in made_events(at_stops=True):
        state(event)
    eye = above_drive(state, FIRST)
    position, looked_at = (np.array(each.as_arrow_array().to_pylist()[0]) for each in (eye.position, eye.look_target))
    places_m = np.array([stop.T_first_stop.xyz_m for stop in STOPS])
    np.testing.assert_allclose(looked_at, places_m.mean(axis=0), atol=1e-5)
    assert position[2] > np.ptp(places_m[:, 0]) + np.linalg.norm((position - looked_at)[:2])


def test_clouds_of_stops_are_within_the_limits(tmp_path):
    tight = RecordConfig(max_megabytes=30.0)
    scan = Scan(np.zeros((300_000, 3), dtype=np.float32), 1)
    rig = Snapshot(tuple(LidarScans(str(number), (scan,)) for number in range(4)), "rig", "")
    assert limits_for(tight, rig, 8)[1] < limits_for(tight, rig)[1]
    # A hundredth of 30,000 points is the least.
    path = record(tmp_path / "run.rrd", at_stops=True, record={"max_megabytes": 0.001})
    positions = Recording(path).last(cloud_path(FIRST, "rear"), "Points3D:positions")
    assert len(positions) == 300
