# SPDX-License-Identifier: Apache-2.0
"""Stops of a drive in a recording."""

import numpy as np
import rerun as rr

from multilica import events
from multilica.geometry import FloatArray, RigidTransform
from multilica.results import DriveView, StopPose
from multilica.sinks.drawing import KEPT, MUTED
from multilica.sinks.rerun.scene import STOP_TIMELINE, RerunScene, drive_path, lidar_frame, rigid, stop_frame

_AXIS_LENGTH_M = 2.0
_LABEL_RADIUS_PIXELS = 4.0
_LINKS = {True: ("used", KEPT, 2.0), False: ("unused", MUTED, 1.0)}


def log_drive(scene: RerunScene, event: events.StopsLinked) -> None:
    """Log the vehicle at each stop with its links, then the clouds of the stops, one stop at a time."""
    poses = {pose.source: pose for pose in scene.state.rig}
    for stop in event.stops:
        _log_vehicle(scene, stop)
    _log_links(scene, event, poses)
    for number, stop in enumerate(event.stops, start=1):
        scene.at_stop(number)
        for lidar, pose in poses.items():
            points_m = event.points_m.get(DriveView(lidar, stop.name))
            if points_m is not None:
                path = _log_cloud(scene, stop, pose, points_m)
                if number < len(event.stops):
                    _empty_at(scene, path, number + 1)
    scene.at_stop(0)


def _log_vehicle(scene: RerunScene, stop: StopPose) -> None:
    frame, path = stop_frame(stop.name), drive_path(stop.first, "stops", stop.name)
    pose = rigid(frame, lidar_frame(scene.state.target), stop.T_first_stop)
    scene.log(path, rr.CoordinateFrame(frame), pose, rr.TransformAxes3D(_AXIS_LENGTH_M))
    radius = rr.Radius.ui_points(_LABEL_RADIUS_PIXELS)
    name = rr.Points3D(np.zeros((1, 3)), colors=[KEPT], labels=[stop.name], radii=radius, show_labels=True)
    scene.log_in(frame, drive_path(stop.first, "stops", stop.name, "name"), name)


def _log_links(scene: RerunScene, event: events.StopsLinked, poses: dict[str, RigidTransform]) -> None:
    """Log a line between the LiDARs of each link, from the target if a LiDAR has no pose."""
    stops = {stop.name: stop for stop in event.stops}

    def place_m(lidar: str, stop: str) -> FloatArray:
        on_vehicle = poses[lidar].xyz_m if lidar in poses else np.zeros(3)
        return np.asarray(stops[stop].T_first_stop.apply(on_vehicle[None])[0])

    for first in dict.fromkeys(stop.first for stop in event.stops):
        group = {stop.name for stop in event.stops if stop.first == first}
        for used, (name, colour, radius_pixels) in _LINKS.items():
            strips = [
                [place_m(link.target, link.target_stop), place_m(link.source, link.source_stop)]
                for link in event.links
                if link.used == used and link.stops <= group
            ]
            if strips:
                lines = rr.LineStrips3D(strips, colors=[colour], radii=rr.Radius.ui_points(radius_pixels))
                scene.log_in(lidar_frame(scene.state.target), drive_path(first, "links", name), lines)


def _log_cloud(scene: RerunScene, stop: StopPose, pose: RigidTransform, points_m: FloatArray) -> str:
    """Log a LiDAR's cloud at a stop."""
    lidar = pose.source
    frame, path = stop_frame(stop.name, lidar), drive_path(stop.first, "stops", stop.name, "lidars", lidar)
    scene.log(path, rigid(frame, stop_frame(stop.name), pose))
    scene.log_points(path, frame, points_m, scene.colour(lidar), scene.limits.stop_points)
    return path


def _empty_at(scene: RerunScene, path: str, number: int) -> None:
    """Leave no points of a cloud from that stop on, on the timeline of stops alone."""
    time = [rr.TimeColumn(STOP_TIMELINE, sequence=[number])]
    scene.stream.send_columns(path, time, rr.Points3D.columns(positions=np.empty((0, 3))).partition([0]))
