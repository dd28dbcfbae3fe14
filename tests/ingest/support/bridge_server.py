# SPDX-License-Identifier: Apache-2.0
"""A vehicle that runs a Foxglove WebSocket server: ``bridge_server.py ENCODING PORT SILENT [PAUSE_S]``.

ENCODING is ``cdr``, ``ros1``, ``protobuf`` or ``json``. SILENT names a LiDAR that is offered, yet sends nothing, or a
scan every PAUSE_S seconds.
"""

from __future__ import annotations

import base64
import json
import math
import sys
import time
from dataclasses import replace
from itertools import cycle

import foxglove
from foxglove import Channel, Schema, ServerListener
from foxglove.messages import PackedElementField, PackedElementFieldNumericType, PointCloud, Timestamp

from multilica.geometry import RigidTransform
from multilica.pointcloud2 import encode_points
from multilica.snapshot import LidarScans, Scan, Snapshot
from tests.ingest.support.recording_writers import (
    CLOUD,
    TRANSFORMS,
    in_order,
    make_snapshot,
    raw_messages,
    ros1_types,
    ros2_types,
)

POSE = RigidTransform.from_xyz_rpy("base", "lidar_1", [1.0, 2.0, 3.0], [0.1, 0.2, 0.3])
PERIOD_S = 0.01
LATE_S = 0.2
"""After this, static transforms follow a subscription: after the first scans."""
ROS = ("cdr", "ros1")
STORES = {"cdr": ros2_types(), "ros1": ros1_types()}


def vehicle() -> Snapshot:
    """What it sees, over and over again; it stamps each scan when it sends it."""
    return Snapshot(make_snapshot(frames=4).lidars, static_transforms=(POSE,))


def schema_of(encoding: str, message_type: str = CLOUD) -> Schema:
    name = {"cdr": message_type, "ros1": message_type.replace("/msg/", "/")}.get(encoding, "foxglove.PointCloud")
    return Schema(name=name, encoding="ros2msg" if encoding in ROS else "protobuf", data=b"")


def encoded(encoding: str, lidar: LidarScans, scan: Scan) -> bytes:
    if encoding in ROS:
        alone = Snapshot((replace(lidar, scans=(scan,)),))
        ((_, _, _, data),) = raw_messages(alone, STORES[encoding], encoding)
        return data
    return as_protobuf(lidar, scan) if encoding == "protobuf" else as_json(lidar, scan)


def as_protobuf(lidar: LidarScans, scan: Scan) -> bytes:
    cloud = encode_points(scan.points_m, scan.intensity)
    kind = PackedElementFieldNumericType.Float32
    return PointCloud(
        timestamp=Timestamp(*divmod(scan.stamp_ns, 10**9)),
        frame_id=lidar.frame_id,
        point_stride=cloud.point_step,
        fields=[PackedElementField(name=field.name, offset=field.offset, type=kind) for field in cloud.fields],
        data=bytes(cloud.data),
    ).encode()


def as_json(lidar: LidarScans, scan: Scan) -> bytes:
    cloud = encode_points(scan.points_m, scan.intensity)
    seconds, nanoseconds = divmod(scan.stamp_ns, 10**9)
    table = {
        "timestamp": {"sec": seconds, "nsec": nanoseconds},
        "frame_id": lidar.frame_id,
        "pose": {"position": {"x": 0, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}},
        "point_stride": cloud.point_step,
        "fields": [{"name": field.name, "offset": field.offset, "type": 7} for field in cloud.fields],
        "data": base64.b64encode(bytes(cloud.data)).decode(),
    }
    return json.dumps(table).encode()


class Latch(ServerListener):
    """Sends static transforms to whoever subscribes, as bridges do with what is latched."""

    def __init__(self) -> None:
        self.pending: list[tuple[float, Channel, bytes]] = []
        self.messages: dict[str, tuple[Channel, bytes]] = {}

    def on_subscribe(self, client: object, channel: object) -> None:
        del client
        if channel.topic in self.messages:
            self.pending.append((time.monotonic() + LATE_S, *self.messages[channel.topic]))

    def send(self) -> None:
        while self.pending and self.pending[0][0] <= time.monotonic():
            _, channel, kept = self.pending.pop(0)
            channel.log(kept)


def main(encoding: str, port: int, silent: str, pause_s: float = math.inf) -> None:
    latch = Latch()
    server = foxglove.start_server(port=port, server_listener=latch)
    chatter = Channel("/chatter", message_encoding="json")
    channels = {
        lidar.topic: Channel(lidar.topic, message_encoding=encoding, schema=schema_of(encoding))
        for lidar in vehicle().lidars
    }
    if encoding in ROS:
        (topic, _, _, data), *_ = raw_messages(vehicle(), STORES[encoding], encoding)
        static = Channel(topic, message_encoding=encoding, schema=schema_of(encoding, TRANSFORMS))
        latch.messages[topic] = (static, data)
    print(server.port, flush=True)
    sent_s = time.monotonic()
    for lidar, scan in cycle(list(in_order(vehicle()))):
        stamped = replace(scan, stamp_ns=time.time_ns())
        if lidar.name != silent or time.monotonic() - sent_s > pause_s:
            sent_s = time.monotonic() if lidar.name == silent else sent_s
            channels[lidar.topic].log(encoded(encoding, lidar, stamped), log_time=stamped.stamp_ns)
        chatter.log({"text": "hello"})
        latch.send()
        time.sleep(PERIOD_S)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3], *map(float, sys.argv[4:]))
