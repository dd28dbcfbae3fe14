# SPDX-License-Identifier: Apache-2.0
"""`multilica simulate`: a snapshot whose truth is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from multilica_cli.options import mcap_name
from multilica_cli.terminal import stdout_console

if TYPE_CHECKING:
    from multilica.snapshot import Snapshot

__all__ = ["simulate"]


def simulate(
    *,
    rig: Annotated[
        str, typer.Option(metavar="NAME", help="LiDARs of the vehicle: edgar, helipr, sides, chain, blind.")
    ],
    scene: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Surroundings: street, parking, garage, symmetric_garage, tunnel, open_field, fence_field.",
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            metavar="FILE.mcap", help="The recording; FILE.truth.toml is written beside it.", callback=mcap_name
        ),
    ],
    seed: Annotated[int, typer.Option(help="Seed of scene, rig and noise.")] = 0,
    build_seed: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Seed of the rig alone: the same vehicle in another scene.",
            show_default="as --seed",
        ),
    ] = None,
    frames: Annotated[int, typer.Option(help="Frames per LiDAR.")] = 5,
    disturb: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="What goes wrong: rain, truck, pedestrians, moving, low_overlap, dead:LIDAR, dirty:LIDAR; repeatable.",
        ),
    ] = None,
    keep_every: Annotated[
        int, typer.Option(metavar="N", min=1, help="Keep every Nth return only, for a small file.")
    ] = 1,
) -> None:
    """Ray-cast a scene into a rig, and write the snapshot with its exact truth beside it."""
    import tomli_w

    from multilica.extrinsics import extrinsics_table
    from multilica.simulate import simulate_snapshot
    from multilica.sinks.atomic import write_text_atomically
    from multilica.sinks.snapshot_mcap import write_snapshot_mcap

    simulation = simulate_snapshot(
        rig, scene, seed, frames=frames, disturbances=tuple(disturb or ()), build_seed=build_seed
    )
    truth = out.with_suffix(".truth.toml")
    out.parent.mkdir(parents=True, exist_ok=True)
    write_snapshot_mcap(_thinned(simulation.snapshot, keep_every), out)
    write_text_atomically(truth, tomli_w.dumps(extrinsics_table(simulation.truth)))
    console = stdout_console()
    for path in (out, truth):
        console.print(f"wrote {path}")


def _thinned(snapshot: Snapshot, keep_every: int) -> Snapshot:
    """Every Nth return, from another one on in each frame."""
    lidars = tuple(
        replace(
            lidar,
            scans=tuple(
                replace(scan, points_m=scan.points_m[index % keep_every :: keep_every])
                for index, scan in enumerate(lidar.scans)
            ),
        )
        for lidar in snapshot.lidars
    )
    return replace(snapshot, lidars=lidars)
