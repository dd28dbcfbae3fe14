# SPDX-License-Identifier: Apache-2.0
"""A vehicle that drives on after every second look at it: ``drive_server.py PORT STOP1.mcap STOP2.mcap ...``.

A look ends when nobody listens any more, so that none sees two stops. With one stop, the vehicle stands.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import foxglove
from foxglove import Channel, ServerListener

from multilica import read_snapshot
from tests.ingest.support.bridge_server import PERIOD_S, encoded, schema_of

LOOKS = 2


class Looks(ServerListener):
    """Counts the looks that have ended."""

    def __init__(self) -> None:
        self.ended, self.heard = 0, 0

    def on_subscribe(self, client: object, channel: object) -> None:
        del client, channel
        self.heard += 1

    def on_unsubscribe(self, client: object, channel: object) -> None:
        del client, channel
        self.heard -= 1
        self.ended += self.heard == 0


def main(port: int, *paths: str) -> None:
    stops = [read_snapshot(path) for path in paths]
    topics = {lidar.name: lidar.topic for lidar in stops[0].lidars}
    looks = Looks()
    server = foxglove.start_server(port=port, server_listener=looks)
    channels = {name: Channel(topic, message_encoding="cdr", schema=schema_of("cdr")) for name, topic in topics.items()}
    print(server.port, flush=True)
    while True:
        stop = stops[min(looks.ended // LOOKS, len(stops) - 1)]
        for lidar in stop.lidars:
            stamped = replace(lidar.scans[0], stamp_ns=time.time_ns())
            channels[lidar.name].log(encoded("cdr", lidar, stamped), log_time=stamped.stamp_ns)
        time.sleep(PERIOD_S)


if __name__ == "__main__":
    main(int(sys.argv[1]), *sys.argv[2:])
