# SPDX-License-Identifier: Apache-2.0
"""A simulated vehicle at several stops of one drive, two of its LiDARs without a common view."""

from dataclasses import replace
from functools import cache
from unittest.mock import patch

import numpy as np
import pytest

from multilica import calibrate
from multilica.config import CalibrationConfig, with_overrides
from multilica.diagnosis import explain
from multilica.drive_calibration import calibrate_stops
from multilica.geometry import RigidTransform
from multilica.results import Knock, TimeLimit
from multilica.results.building import provenance_of, result_document
from multilica.results.document import parse_result
from multilica.run import run_calibration
from multilica.simulate import RIGS, simulate_snapshot, true_extrinsics
from multilica.simulate.models import FALCON
from multilica.simulate.rigs import Mount, Rig, car
from multilica.sinks.report.contents import ReportContents
from multilica.sinks.report.drive_map import drive_maps, links_of
from multilica.sinks.report.page import report_html
from multilica.sinks.snapshots import write_snapshot_mcap
from tests.sinks.recording_reader import Recording

pytestmark = pytest.mark.slow

_OPPOSITE = Rig(
    "opposite",
    (
        Mount("front", FALCON, (1.2, 0.0, 1.9), (0.0, 5.0, 0.0)),
        Mount("rear", FALCON, (-1.2, 0.0, 1.9), (1.0, 6.0, 180.0)),
    ),
    car(1.7, 1.2, 1.1),
)
_LIDARS = ("front", "rear")
_CONFIG = with_overrides(CalibrationConfig(), ["runtime.workers=1"])
_TURNING = ((0.0, 0.0, 0.0), (4.0, 2.5, 90.0), (1.0, 6.0, 160.0))
_STRAIGHT = ((0.0, 0.0, 0.0), (5.0, 0.0, 0.0), (10.0, 0.0, 0.0))


def _at(x_m, y_m, yaw_deg):
    return RigidTransform.from_xyz_rpy("base", "base", (x_m, y_m, 0.0), (0.0, 0.0, np.deg2rad(yaw_deg)))


def _truth(seed):
    with patch.dict(RIGS, {"opposite": _OPPOSITE}):
        return true_extrinsics("opposite", seed)


def _stop(place, seed):
    """All LiDARs moved on the vehicle as the vehicle moves, which stays behind as a parked car."""
    poses = {name: _truth(seed).between("base", name) for name in _LIDARS}
    moved = {name: pose.inverse() @ _at(*place) @ pose for name, pose in poses.items()}
    with patch.dict(RIGS, {"opposite": _OPPOSITE}):
        snapshot = simulate_snapshot("opposite", "street", 1, build_seed=seed, frames=1, moved=moved).snapshot
    return replace(snapshot, static_transforms=())


@cache
def _calibrated(places, seed=3):
    return calibrate([_stop(place, seed) for place in places], _CONFIG)


def _error(result, lidar, seed=3):
    return result[lidar].T_target_source.distance_to(_truth(seed).between(result.target, lidar))


def test_a_drive_that_turns_places_lidars_without_a_common_view():
    result = _calibrated(_TURNING)
    assert result.time_limit is None
    (other,) = {*_LIDARS} - {result.target}
    metres, radians = _error(result, other)
    assert metres < 0.02
    assert np.rad2deg(radians) < 0.2
    assert "links between stops" in result[other].reason
    own = _truth(3).between("base", result.target)
    for stop in result.stops:
        places = [_at(*_TURNING[int(name[-1]) - 1]) @ own for name in (stop.first, stop.name)]
        assert np.abs((places[0].inverse() @ places[1]).matrix - stop.T_first_stop.matrix).max() < 0.02


@pytest.mark.in_turn
def test_with_a_half_turn_links_count_that_fit_nowhere_else():
    """Stops that are half a turn apart tell no position between them: each link has to fit at one place only."""
    result = _calibrated((*_TURNING[:2], (1.0, 6.0, 180.0)))
    (other,) = {*_LIDARS} - {result.target}
    assert result[other].placed
    metres, radians = _error(result, other)
    assert metres < 0.02
    assert np.rad2deg(radians) < 0.2


def test_the_document_and_the_map_have_the_stops():
    result = _calibrated(_TURNING)
    snapshot = _stop(_TURNING[0], 3)
    knocked = replace(result, knocks=(Knock("rear", "stop 1", "stop 2", 0.021, 0.1, ("stop 1",)),))
    document = parse_result("made", result_document(knocked, _CONFIG, provenance_of(snapshot)).model_dump_json())
    assert [stop.name for stop in document.stops] == [stop.name for stop in result.stops]
    (shown,) = drive_maps(document, RigidTransform.identity("level", result.target))
    assert [stop.name for stop in shown.stops] == [stop.name for stop in result.stops]
    assert sum(links.used for links in shown.links) == sum(link.used for link in result.links)
    page = report_html(ReportContents(document, {lidar.name: lidar.points_m[::50] for lidar in snapshot.lidars}))
    assert "Map of the stops from above" in page
    assert "rear moved by 21 mm, 0.10 deg between stop 1 and stop 2" in page
    assert min(links_of(document)[stop.name] for stop in result.stops) > 0


def test_links_that_there_is_no_time_for_are_told():
    stops = [_stop(place, 3) for place in _TURNING[:2]]
    config = with_overrides(_CONFIG, ["runtime.max_time_s=600.0"])
    result = calibrate_stops(stops, config, deadline_s=0.0)
    assert result.links == ()
    assert result.time_limit == TimeLimit(600.0, (("front", "rear"),), (("stop 1", "stop 2"),))
    explanation = explain(result_document(result, config, provenance_of(stops[0])))
    assert [missing.cause for missing in explanation.missing] == ["out_of_time"]
    assert any("no time for further links between stops: stop 1 - stop 2" in each for each in explanation.warnings)


@pytest.mark.nightly
def test_a_straight_drive_invents_nothing():
    result = _calibrated(_STRAIGHT)
    assert {place.status for place in result.placements if place.lidar != result.target} == {"not_placed"}


@pytest.mark.nightly
def test_a_run_records_the_clouds_of_all_stops(tmp_path):
    paths = [tmp_path / f"stop{number}.mcap" for number in (1, 2, 3)]
    for path, place in zip(paths, _TURNING, strict=True):
        write_snapshot_mcap(_stop(place, 3), path)
    run = run_calibration(paths, tmp_path / "run", _CONFIG)
    shown = Recording(tmp_path / "run" / "recording.rrd").entity_paths
    first = run.result.stops[0].name
    clouds = {f"/drive/{first}/stops/{stop.name}/lidars/{lidar}" for stop in run.result.stops for lidar in _LIDARS}
    assert len(clouds) == 6
    assert clouds | {f"/drive/{first}/links/used"} <= shown
