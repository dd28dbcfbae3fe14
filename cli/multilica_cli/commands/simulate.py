# SPDX-License-Identifier: Apache-2.0
"""`multilica simulate`: simulated recordings with ground truth, one or those of a fleet."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from multilica.errors import UsageError
from multilica_cli.options import local_path, mcap_name, option
from multilica_cli.terminal import stdout_console

if TYPE_CHECKING:
    from multilica.extrinsics import Extrinsics
    from multilica.snapshot import Snapshot

_FRAMES, _STOPS = 5, 4
# A standstill lasts a second or more.
_DRIVE_FRAMES = 15
_one = partial(option, rich_help_panel="A recording")
_many = partial(option, rich_help_panel="A fleet")


def simulate(
    *,
    rig: Annotated[
        str | None,
        _one(
            "--rig NAME",
            "Vehicle: edgar, helipr, sides, chain, blind, ring6, sectors8, sectors20, truck, front_back, corners, "
            "narrow4, trailer. Required.",
        ),
    ] = None,
    scene: Annotated[
        str | None,
        _one(
            "--scene NAME",
            "Scene: street, parking, garage, symmetric_garage, tunnel, tunnel_niches, open_field, fence_field, "
            "motorway, motorway_exit, bridge, avenue, car_park, court, yard, town, equal_houses. Required.",
        ),
    ] = None,
    out: Annotated[
        Path | None, _one("--out FILE.mcap", "Recording to write, with FILE.truth.toml. Required.", callback=mcap_name)
    ] = None,
    build_seed: Annotated[
        int | None, _one("--build-seed N", "Seed of the mounting only: the same vehicle in another scene.", "as --seed")
    ] = None,
    disturb: Annotated[
        list[str] | None,
        _one(
            "--disturb NAME",
            "Disturbance: rain, truck (beside the vehicle), pedestrians, moving, ego_masked, low_overlap, "
            "dead:LIDAR, dirty:LIDAR, traffic:one_way, traffic:both_ways, traffic:queue. Repeatable.",
        ),
    ] = None,
    sensors: Annotated[
        Literal["real", "ideal"] | None,
        _one(
            "--sensors KIND",
            "real: LiDARs with the systematic errors that datasheets allow; ideal: with white noise only.",
            "real",
        ),
    ] = None,
    drive: Annotated[
        Literal["straight", "turning", "exit", "yard"] | None,
        _one(
            "--drive ROUTE",
            "A whole log: the vehicle stands, drives on and stands again. straight: on, 6 m each time; turning: round "
            "by half a turn in all; exit: along a bend; yard: round a yard. FILE.truth.toml has its poses, too.",
        ),
    ] = None,
    stops: Annotated[int | None, _one("--stops N", "Stops of a drive.", f"{_STOPS}", min=1)] = None,
    parked: Annotated[
        int | None, _one("--parked N", "Parked cars beside a drive that leave or come between the stops.", "0", min=0)
    ] = None,
    fleet: Annotated[
        Path | None,
        _many(
            "--fleet DIR",
            "New folder for logs of many vehicles over a year, in several formats, with LiDARs that jump, creep "
            "or die, broken files and duplicates; fleet.truth.json lists them.",
            callback=local_path,
        ),
    ] = None,
    vehicles: Annotated[int | None, _many("--vehicles N", "Vehicles.", "20")] = None,
    logs: Annotated[int | None, _many("--logs N", "Logs of all vehicles.", "200")] = None,
    workers: Annotated[
        int | None,
        _many(
            "--workers N", "Worker processes; 1: none. The files are the same with any number.", "one per core", min=1
        ),
    ] = None,
    seed: Annotated[int, option("--seed", "Seed of scenes, mounting, noise and events.")] = 0,
    frames: Annotated[
        int | None,
        option(
            "--frames",
            "Frames per LiDAR, and per stop of a drive.",
            f"{_FRAMES}; {_DRIVE_FRAMES} at a stop of a drive; 2 for a fleet",
        ),
    ] = None,
    keep_every: Annotated[
        int | None, option("--keep-every N", "Keep only every Nth return.", "1; 12 for a fleet", min=1)
    ] = None,
) -> None:
    """Simulate a recording, or with --fleet the logs of many vehicles, by ray casting, with exact ground truth."""
    one = {
        "--rig": rig,
        "--scene": scene,
        "--out": out,
        "--build-seed": build_seed,
        "--disturb": disturb or None,
        "--sensors": sensors,
        "--drive": drive,
        "--stops": stops,
        "--parked": parked,
    }
    many = {"--vehicles": vehicles, "--logs": logs, "--workers": workers}
    if fleet is not None:
        _refuse(one, "is for a single recording; leave it out with --fleet")
        given = {"vehicles": vehicles, "logs": logs, "frames": frames, "keep_every": keep_every}
        chosen = {name: value for name, value in given.items() if value is not None}
        _simulate_fleet(fleet, workers or 0, seed=seed, **chosen)
        return
    _refuse(many, "is for a fleet; give --fleet DIR, too, or leave it out")
    if rig is None or scene is None or out is None:
        missing = ", ".join(name for name in ("--rig", "--scene", "--out") if one[name] is None)
        raise UsageError(f"Missing {missing}; give --rig, --scene and --out for a recording, or --fleet for many.")
    from multilica.simulate import simulate_drive, simulate_snapshot, thinned
    from multilica.sinks.snapshots import write_ros2_mcap, write_snapshot_mcap

    usual = _FRAMES if drive is None else _DRIVE_FRAMES
    count, every, kind = usual if frames is None else frames, keep_every or 1, sensors or "real"
    disturbances = tuple(disturb or ())
    if drive is not None:
        made = simulate_drive(
            rig,
            scene,
            seed,
            route=drive,
            stops=_STOPS if stops is None else stops,
            frames=count,
            disturbances=disturbances,
            parked=parked or 0,
            build_seed=build_seed,
            sensors=kind,
            keep_every=every,
            with_log=True,
        )
        _write_recording(write_ros2_mcap, made.log or made.snapshots[0], made.truth, out, stops=made.stops_table())
        return
    _refuse({"--stops": stops, "--parked": parked}, "is for a drive; give --drive ROUTE, too, or leave it out")
    alone = simulate_snapshot(
        rig, scene, seed, frames=count, disturbances=disturbances, build_seed=build_seed, sensors=kind
    )
    _write_recording(write_snapshot_mcap, thinned(alone.snapshot, every), alone.truth, out)


def _refuse(options: Mapping[str, object], reason: str) -> None:
    given = next((name for name, value in options.items() if value is not None), None)
    if given is not None:
        raise UsageError(f"{given} {reason}.")


def _write_recording(
    write: Callable[[Snapshot, Path], None], snapshot: Snapshot, truth: Extrinsics, out: Path, **more: object
) -> None:
    import tomli_w

    from multilica.extrinsics import extrinsics_table
    from multilica.sinks.files.atomic import write_text_atomically

    out.parent.mkdir(parents=True, exist_ok=True)
    write(snapshot, out)
    truth_file = out.with_suffix(".truth.toml")
    write_text_atomically(truth_file, tomli_w.dumps(extrinsics_table(truth) | more))
    for path in (out, truth_file):
        stdout_console().print(f"wrote {path}")


def _simulate_fleet(out: Path, workers: int, **chosen: int) -> None:
    from multilica.fleet.simulated_logs import write_fleet
    from multilica.simulate import plan_fleet
    from multilica_cli.progress import show_count

    plan = plan_fleet(**chosen)
    with show_count("logs", len(plan.logs)) as advance:
        truth = write_fleet(plan, out, workers=workers, observe=lambda _: advance())
    broken = sum(bool(log.fault) for log in plan.logs)
    copies = sum(bool(log.duplicate_of) for log in plan.logs)
    console = stdout_console()
    console.print(
        f"wrote {out} (vehicles: {len(plan.build_seeds)}, logs: {len(plan.logs)}, of these broken: {broken}, "
        f"duplicates: {copies}; events: {len(plan.events)})"
    )
    console.print(f"wrote {truth}")
