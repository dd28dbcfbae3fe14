# SPDX-License-Identifier: Apache-2.0
"""The events of a joint result with linked stops."""

from dataclasses import replace

import numpy as np

from multilica import events
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
