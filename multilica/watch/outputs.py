# SPDX-License-Identifier: Apache-2.0
"""Outputs of a watch beside its lines: diagnostics of ROS 2, metrics for Prometheus, rows of a fleet store."""

import time
from collections.abc import Callable
from dataclasses import replace

import multilica
from multilica.checks import relative_covariance
from multilica.errors import UsageError
from multilica.fleet.store.records import LidarRow, LogRow, with_pose
from multilica.fleet.store.store import Store
from multilica.optional_libraries import needed_for
from multilica.ros2 import Ros2Node
from multilica.sinks.mcap import ros2_types
from multilica.watch.loop import Observation

DIAGNOSTICS_TOPIC = "/diagnostics"
_DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
_OK, _WARN, _ERROR, _STALE = range(4)
_LEVELS = {"within": _OK, "outside": _ERROR, "undecided": _WARN, "moving": _STALE, "failed": _WARN}

Tell = Callable[[Observation], None]


def diagnostics_on(node: Ros2Node) -> Tell:
    """Return what publishes each observation on `/diagnostics`: a status for the rig, and one per LiDAR of a verdict.

    Raises:
        MissingDependencyError: the package of the message type is not installed.
    """
    send = node.publisher(DIAGNOSTICS_TOPIC, _DIAGNOSTICS, latched=False)
    return lambda observation: send(diagnostic_message(observation))


def diagnostic_message(observation: Observation) -> bytes:
    """Encode ``diagnostic_msgs/msg/DiagnosticArray``."""
    check = observation.check
    statuses = [_status("rig", observation.outcome, observation.text, {})]
    for each in check.lidars if check else ():
        figures = {
            "distance_m": each.distance_m,
            "angle_deg": each.angle_deg,
            "max_translation_m": each.max_translation_m,
            "max_rotation_deg": each.max_rotation_deg,
        }
        values = {name: f"{value:.6g}" for name, value in figures.items() if value is not None}
        statuses.append(_status(each.lidar, each.verdict, each.reason or each.verdict, values))
    stamp_ns = observation.time_ns if 0 <= observation.time_ns < ros2_types.ROS_END_NS else time.time_ns()
    return ros2_types.serialised(ros2_types.made(_DIAGNOSTICS, header=ros2_types.header("", stamp_ns), status=statuses))


def _status(name: str, outcome: str, text: str, values: dict[str, str]) -> object:
    pairs = [ros2_types.made("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in values.items()]
    return ros2_types.made(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=_LEVELS[outcome],
        name=f"multilica: {name}",
        message=text,
        hardware_id=name,
        values=pairs,
    )


def metrics_at(port: int) -> Tell:
    """Serve metrics for Prometheus on all interfaces, and return what updates them.

    Raises:
        MissingDependencyError: the library is not installed.
        UsageError: the port is taken.
    """
    with needed_for("Metrics for Prometheus", "prometheus_client"):
        from prometheus_client import CollectorRegistry, Counter, Gauge, start_http_server
    registry = CollectorRegistry()
    looks = Counter("multilica_looks", "Looks at the vehicle by outcome.", ["outcome"], registry=registry)
    last_s = Gauge("multilica_last_verdict_seconds", "Time of the last verdict, since 1970.", registry=registry)
    within = Gauge(
        "multilica_lidar_within", "1: at its pose; 0: outside; NaN: undecided.", ["lidar"], registry=registry
    )
    off_m = Gauge("multilica_lidar_distance_m", "Distance from the known pose.", ["lidar"], registry=registry)
    off_deg = Gauge("multilica_lidar_angle_deg", "Rotation from the known pose.", ["lidar"], registry=registry)
    for outcome in _LEVELS:
        looks.labels(outcome)
    try:
        start_http_server(port, registry=registry)
    except (OSError, OverflowError) as error:
        raise UsageError(f"Metrics cannot be served at port {port}: {error}.") from error

    def tell(observation: Observation) -> None:
        looks.labels(observation.outcome).inc()
        if observation.check is None:
            return
        last_s.set(observation.time_ns / 1e9)
        for gauge in (within, off_m, off_deg):
            gauge.clear()
        for each in observation.check.lidars:
            within.labels(each.lidar).set({"within": 1.0, "outside": 0.0}.get(each.verdict, float("nan")))
            if each.distance_m is not None and each.angle_deg is not None:
                off_m.labels(each.lidar).set(each.distance_m)
                off_deg.labels(each.lidar).set(each.angle_deg)

    return tell


def rows_into(store: Store, vehicle: str, source: str) -> Tell:
    """Return what writes each verdict into a fleet store: a log of its own, with the poses that were found."""

    def tell(observation: Observation) -> None:
        if observation.check is None or observation.found is None or observation.known is None:
            return
        key = f"watch-{observation.time_ns}"
        log = LogRow(
            key,
            vehicle,
            observation.time_ns,
            source,
            key,
            0,
            "verified",
            reason_text=observation.text,
            version=multilica.__version__,
        )
        rows = _rows(log, observation)
        placed = sum(row.status == "placed" for row in rows)
        store.finish(replace(log, lidars=len(rows), placed=placed), rows)

    return tell


def _rows(log: LogRow, observation: Observation) -> list[LidarRow]:
    """Return the poses relative to the target of the calibration, or to a fixed LiDAR if that is a frame without one.

    Without a pose of its target, no LiDAR has one.
    """
    check, found, known = observation.check, observation.found, observation.known
    if check is None or found is None or known is None:
        return []
    names = {place.lidar for place in found.placements}
    target = known.target if known.target in names else min(names & known.members)
    T_root_target = found.poses.get(target)
    rows = []
    for place in found.placements:
        pose, is_target = found.poses.get(place.lidar), place.lidar == target
        row = LidarRow(log.key, log.time_ns, log.source, place.lidar, target, "verified", place.status)
        if pose is None or T_root_target is None:
            reason = "no_target" if pose is not None else "against_prior" if place.contradicts_prior else "unverified"
            row = replace(row, status="not_placed", reason=reason, reason_text=place.reason)
        else:
            covariance = None if is_target else relative_covariance(found[target], place, found.target)
            row = with_pose(row, T_root_target.inverse() @ pose, covariance)
            row = row if place.placed else replace(row, reason="uncertain", reason_text=place.reason)
        rows.append(row)
    for absent in (each for each in check.lidars if each.lidar not in names):
        row = LidarRow(log.key, log.time_ns, log.source, absent.lidar, target, "verified", "not_placed")
        rows.append(replace(row, reason="no_topic", reason_text=absent.reason))
    return rows
