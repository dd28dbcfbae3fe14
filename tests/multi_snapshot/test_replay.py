# SPDX-License-Identifier: Apache-2.0
"""The events of a joint result with linked stops."""

from dataclasses import replace

import numpy as np
import pytest

from multilica import events
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.multi_snapshot import replay
from multilica.orchestration.pairs import PreparedLidar
from multilica.orchestration.stop_views import DriveStop
from multilica.results import DriveView, FeatureCloud, SnapshotReport
from tests.sinks.made_drive import FIRST, LINKS, STOPS
from tests.sinks.made_events import LIDARS, made_events


def _stop(name, clouds, config):
    features = FeatureCloud("", np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 33)))
    return DriveStop(name, {lidar: PreparedLidar(cloud, features, None, config) for lidar, cloud in clouds.items()}, ())


def _replayed(*, drive):
    told = [*made_events(at_stops=drive)]
    clouds = {event.cloud.lidar: event.cloud for event in told if isinstance(event, events.CloudPreprocessed)}
    started, finished = told[0], told[-1]
    result = replace(finished.result, snapshots=(SnapshotReport(FIRST, "made", ""),))
    stops = [_stop(name, clouds, started.config) for name in (*(stop.name for stop in STOPS), "elsewhere")]
    seen = []
    replay(started.snapshot, result, started.config, seen.append, stops=stops)
    return seen, clouds


def test_linked_stops_are_told_with_their_clouds():
    seen, clouds = _replayed(drive=True)
    assert seen[0].stops == tuple(stop.name for stop in STOPS)
    (linked,) = [event for event in seen if isinstance(event, events.StopsLinked)]
    assert (linked.stops, linked.links) == (STOPS, LINKS)
    assert linked.points_m.keys() == {DriveView(lidar, stop.name) for lidar in LIDARS for stop in STOPS}
    assert all(linked.points_m[view] is clouds[view.lidar].points_m for view in linked.points_m)
    order = [type(event) for event in seen]
    assert order.index(events.RigRefined) < order.index(events.StopsLinked)


def test_snapshots_without_links_are_no_drive():
    seen, _ = _replayed(drive=False)
    assert seen[0].stops == ()
    assert not [event for event in seen if isinstance(event, events.StopsLinked)]


@pytest.mark.parametrize(("digests", "is_kept"), [("aa", True), ("ab", False)], ids=["one log", "two recordings"])
def test_stops_of_one_log_have_its_hash(digests, is_kept):
    told = [*made_events()]
    reports = tuple(SnapshotReport(name, "made", digest) for name, digest in zip("12", digests, strict=True))
    seen = []
    replay(told[0].snapshot, replace(told[-1].result, snapshots=reports), told[0].config, seen.append)
    assert (seen[0].snapshot.source_sha256 == digests[0]) == is_kept


def test_the_level_is_that_of_the_ground():
    """A rig file turns the base frame, and pictures are drawn in it."""
    told = [*made_events()]
    result = replace(told[-1].result, snapshots=(SnapshotReport(FIRST, "made", ""),))
    turned = RigidTransform.from_xyz_rpy("base", "top", (1.0, 2.0, 1.8), (0.0, 0.0, 1.5))
    found = replay(told[0].snapshot, result, told[0].config, lambda _: None, Extrinsics("base", {"top": turned}))
    assert found.ground is not None
    np.testing.assert_array_equal(found.level.matrix, found.ground.T_base_target.matrix)
    assert found.level.rpy_rad[2] == pytest.approx(1.5, abs=0.05)
