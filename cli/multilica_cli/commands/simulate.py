# SPDX-License-Identifier: Apache-2.0
"""`multilica simulate`: simulated snapshot with ground truth."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from multilica_cli.options import mcap_name
from multilica_cli.terminal import stdout_console

__all__ = ["simulate"]


def simulate(
    *,
    rig: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Vehicle: edgar, helipr, sides, chain, blind, ring6, sectors8, sectors20, truck.",
        ),
    ],
    scene: Annotated[
        str,
        typer.Option(
            metavar="NAME", help="Scene: street, parking, garage, symmetric_garage, tunnel, open_field, fence_field."
        ),
    ],
    out: Annotated[
        Path, typer.Option(metavar="FILE.mcap", help="Recording to write, with FILE.truth.toml.", callback=mcap_name)
    ],
    seed: Annotated[int, typer.Option(help="Seed of scene, mounting and noise.")] = 0,
    build_seed: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="Seed of the mounting only: the same vehicle in another scene.", show_default="as --seed"
        ),
    ] = None,
    frames: Annotated[int, typer.Option(help="Frames per LiDAR.")] = 5,
    disturb: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Disturbance: rain, truck (beside the vehicle), pedestrians, moving, ego_masked, low_overlap, "
            "dead:LIDAR, dirty:LIDAR. Repeatable.",
        ),
    ] = None,
    keep_every: Annotated[int, typer.Option(metavar="N", min=1, help="Keep only every Nth return.")] = 1,
) -> None:
    """Simulate a recording by ray casting and write its exact ground truth beside it."""
    import tomli_w

    from multilica.extrinsics import extrinsics_table
    from multilica.simulate import simulate_snapshot
    from multilica.sinks.files.atomic import write_text_atomically
    from multilica.sinks.mcap.snapshot_mcap import write_snapshot_mcap

    simulation = simulate_snapshot(
        rig, scene, seed, frames=frames, disturbances=tuple(disturb or ()), build_seed=build_seed
    )
    lidars = []
    for lidar in simulation.snapshot.lidars:
        # The first return that is kept differs from frame to frame, so that together they cover all beams.
        kept = [scan.points_m[index % keep_every :: keep_every] for index, scan in enumerate(lidar.scans)]
        scans = (replace(scan, points_m=points_m) for scan, points_m in zip(lidar.scans, kept, strict=True))
        lidars.append(replace(lidar, scans=tuple(scans)))
    truth = out.with_suffix(".truth.toml")
    out.parent.mkdir(parents=True, exist_ok=True)
    write_snapshot_mcap(replace(simulation.snapshot, lidars=tuple(lidars)), out)
    write_text_atomically(truth, tomli_w.dumps(extrinsics_table(simulation.truth)))
    console = stdout_console()
    for path in (out, truth):
        console.print(f"wrote {path}")
