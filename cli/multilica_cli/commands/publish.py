# SPDX-License-Identifier: Apache-2.0
"""`multilica publish`: a saved run on topics of ROS 2 and for Foxglove."""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Literal

from multilica.errors import UsageError
from multilica_cli.options import Quiet, argument, option
from multilica_cli.terminal import stderr_console, stdout_console

_HOST = "127.0.0.1"


def publish(
    run: Annotated[Path, argument("RUN", "Run directory, its result.json or result.mcap.")],
    to: Annotated[
        str | None, argument("[ros2://]", "Publish on topics of ROS 2; domain and middleware as ROS_DOMAIN_ID says.")
    ] = None,
    *,
    ws: Annotated[
        str | None, option("--ws [HOST:]PORT", f"Serve Foxglove at this address; without HOST at {_HOST}.")
    ] = None,
    base: Annotated[
        str | None, option("--base FRAME", "Frame of the poses and the cloud, as for export.", "as for export")
    ] = None,
    rig: Annotated[
        Path | None, option("--rig FILE", "Known pose of the target in FRAME: TOML, URDF or any format of export.")
    ] = None,
    frames: Annotated[
        Literal["ids", "names"],
        option("--frames ids|names", "Call frames by the frame ids of the input, or by the LiDARs' names."),
    ] = "ids",
    with_uncertain: Annotated[bool, option("--with-uncertain", "Publish uncertain LiDARs too.")] = False,
    quiet: Quiet = False,
) -> None:
    """Publish the poses of a run on /tf_static, and the clouds of all LiDARs in one frame, until Ctrl-C.

    Late subscribers get both. Exits with 130 after Ctrl-C, 143 after SIGTERM.
    """
    from multilica.exports.publication import publication_of
    from multilica.ingest.remote.address import require_ros2

    if to is not None:
        require_ros2(to)
    if to is None and ws is None:
        raise UsageError("There is nowhere to publish; expected ros2://, --ws PORT, or both.")
    host, port = _host_and_port(ws) if ws is not None else ("", 0)
    found = publication_of(run, base=base, rig=rig, frames=frames, with_uncertain=with_uncertain)
    console, told = stdout_console(quiet=quiet), stderr_console()
    if found.missing:
        listed = ", ".join(f"{name} ({status.replace('_', ' ')})" for name, status in found.missing.items())
        told.print(f"multilica: Without {listed}.")
    with ExitStack() as opened:
        if to is not None:
            from multilica.sinks.live.ros2_topics import on_ros2_topics

            opened.enter_context(on_ros2_topics(found.messages))
        if ws is not None:
            from multilica.sinks.live.foxglove_server import from_foxglove_server

            port = opened.enter_context(from_foxglove_server(found.messages, host, port))
        places = [*(["ros2://"] if to is not None else []), *([f"ws://{host}:{port}"] if ws is not None else [])]
        topics = ", ".join(message.topic for message in found.messages)
        console.print(f"publishing {topics} at {' and '.join(places)}: {', '.join(found.lidars)} in {found.base}")
        while True:
            time.sleep(3600.0)


def _host_and_port(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not port.isascii() or not port.isdigit() or int(port) > 65535:
        raise UsageError(f"Cannot read --ws '{text}'; expected PORT or HOST:PORT, for example --ws 8765.")
    return host or _HOST, int(port)
