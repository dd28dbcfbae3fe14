# SPDX-License-Identifier: Apache-2.0
"""`multilica watch`: verification of a running vehicle whenever it stands."""

from __future__ import annotations

import re
from contextlib import ExitStack, closing
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from multilica.errors import MultilicaError, UsageError
from multilica_cli.commands.check import Compared, MaxRotation, MaxTranslation, tolerances_of
from multilica_cli.options import LIVE_SOURCE, Quiet, argument, option
from multilica_cli.terminal import stderr_console, stdout_console

if TYPE_CHECKING:
    from multilica.ros2 import Ros2Node
    from multilica.watch import Observation
    from multilica.watch.outputs import Tell

_NS_PER_S = 1_000_000_000
_MOST_REASONS = 20


def watch(
    source: Annotated[str, argument("SOURCE", f"{LIVE_SOURCE}.")],
    *,
    calibration: Annotated[Path, option("--calibration FILE", "A calibration.toml, a run, or another file of poses.")],
    max_translation_m: MaxTranslation = 0.03,
    max_rotation_deg: MaxRotation = 0.3,
    tolerances: Annotated[
        Path | None, option("--tolerances FILE", r"TOML with \[default] and \[lidars.NAME], which replace these.")
    ] = None,
    recording: Compared,
    interval_s: Annotated[
        float, option("--interval S", "Least time from one verdict to the next.", min=0.0, max=1e6)
    ] = 60.0,
    timeout_s: Annotated[
        float, option("--timeout S", "Longest wait for the scans of one look.", min=0.1, max=1e6)
    ] = 10.0,
    store: Annotated[
        str | None, option("--store STORE", "Also write each verdict into this store, as of `fleet run`.")
    ] = None,
    vehicle: Annotated[str, option("--vehicle NAME", "Name of the vehicle in the store.")] = "vehicle",
    metrics: Annotated[
        int | None, option("--metrics PORT", "Serve metrics for Prometheus, on all interfaces.", min=1, max=65535)
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Verify a running vehicle whenever it stands, and print a line per verdict; only a signal ends it.

    At ros2://, each look is also a diagnostic_msgs/DiagnosticArray on /diagnostics. Exits with 130 after Ctrl-C, 143
    after SIGTERM, and before it starts with 1, 2 or 3 as other commands.
    """
    from multilica.checks import read_tolerances, require_known_lidars, require_reference
    from multilica.ingest import listen, live_address
    from multilica.ingest.remote.address import ROS2, scheme_of
    from multilica.ros2 import Ros2Node
    from multilica.watch import WatchRequest, watch_vehicle

    address = live_address([source])
    if not address:
        raise UsageError(f"Found {source}; expected {LIVE_SOURCE}. For a recording, use `multilica verify`.")
    limits = tolerances_of(max_translation_m, max_rotation_deg)
    if tolerances is not None:
        limits = read_tolerances(tolerances, limits.default)
    require_reference(calibration)
    config = recording.resolve(timeout_s=timeout_s)
    require_known_lidars(calibration, limits, config.ingest.topics)
    with ExitStack() as opened:
        node = None
        if scheme_of(address) == ROS2:
            node = opened.enter_context(closing(Ros2Node(f"Watching at {address}")))
        tells: list[Tell] = [WatchLines(quiet=quiet), *_outputs(node, metrics, store, vehicle, address)]
        look = partial(listen, address, config=config.ingest, node=node)
        watch_vehicle(WatchRequest(look, calibration, limits, config, interval_s), partial(_tell_all, tells))


def _outputs(node: Ros2Node | None, metrics: int | None, store: str | None, vehicle: str, source: str) -> list[Tell]:
    from multilica.fleet.store.store import open_store, vehicle_name
    from multilica.ingest.remote.address import without_secrets
    from multilica.watch import outputs

    found: list[Tell] = [] if node is None else [outputs.diagnostics_on(node)]
    if metrics is not None:
        found.append(outputs.metrics_at(metrics))
    if store is not None:
        opened = open_store(store, create=True)
        found.append(outputs.rows_into(opened, vehicle_name(vehicle), without_secrets(source)))
    return found


def _tell_all(tells: list[Tell], observation: Observation) -> None:
    """Tell each output; one that fails, such as a store that cannot be reached, does not end the watch."""
    for tell in tells:
        try:
            tell(observation)
        except MultilicaError as failure:
            stderr_console().print(f"multilica: {failure}")


class WatchLines:
    """A line per verdict on stdout; on stderr each reason why there is none, once until the next verdict."""

    def __init__(self, *, quiet: bool) -> None:
        self._quiet = quiet
        self._told: set[str] = set()

    def __call__(self, observation: Observation) -> None:
        """Tell one look."""
        time = f"{datetime.fromtimestamp(observation.time_ns / _NS_PER_S, tz=UTC):%Y-%m-%dT%H:%M:%SZ}"
        line = f"{time} {observation.outcome}: {observation.text}"
        if observation.is_verdict:
            self._told.clear()
            stdout_console(quiet=self._quiet).print(line, soft_wrap=True)
            return
        # Reasons that differ in numbers only are the same one.
        reason = observation.outcome if observation.outcome == "moving" else re.sub(r"\d+", "", observation.text)
        if reason not in self._told and len(self._told) < _MOST_REASONS:
            self._told.add(reason)
            stderr_console(quiet=self._quiet).print(line, soft_wrap=True)
