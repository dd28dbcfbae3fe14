# SPDX-License-Identifier: Apache-2.0
"""`multilica datasets`: the presets side by side on a data set of the paper."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from multilica_cli.configuration import topic_names
from multilica_cli.options import Json, Quiet, Settings, WithinDeg, WithinM, argument, option, output
from multilica_cli.terminal import stdout_console


def datasets(
    name: Annotated[Literal["helipr", "edgar", "opencalib"], typer.Argument(metavar="NAME", help="The data set.")],
    path: Annotated[
        Path,
        argument(
            "PATH",
            "helipr: folder of a sequence. edgar: folder with a ROS 2 bag or a folder of PCD files per scene. "
            "opencalib: lidar2lidar/auto_calib/data, or one folder of it.",
        ),
    ],
    *,
    out: Annotated[
        Path | None, output("--out DIR", "Directory for scenes and runs.", show_default="recordings/runs/<NAME>")
    ] = None,
    presets: Annotated[
        list[str] | None, option("--preset NAME", "Preset to run. Repeatable.", show_default="all")
    ] = None,
    scenes: Annotated[int, option("--scenes N", "Largest number of scenes.")] = 10,
    frames: Annotated[int, option("--frames N", "Frames per LiDAR and scene.")] = 5,
    target: Annotated[str | None, option("--target NAME", "Target LiDAR.", show_default="from the data set")] = None,
    topics: Annotated[
        list[str] | None, option("--topic NAME=/topic", "edgar: the topic of a LiDAR of the truth. Repeatable.")
    ] = None,
    truth: Annotated[
        Path | None,
        option("--truth FILE", "True poses, as TOML or as the authors' config.yaml.", show_default="from the data set"),
    ] = None,
    settings: Settings = None,
    within_m: WithinM = 0.02,
    within_deg: WithinDeg = 0.1,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Run the presets on standstills of a data set of the paper, and print the paper's tables next to its figures."""
    from multilica.config import PRESETS
    from multilica.datasets import READERS, SceneRequest, run_presets
    from multilica.runs import Tolerances
    from multilica_cli.progress import show_progress
    from multilica_cli.tables.paper import print_dataset

    limits = Tolerances(within_m, within_deg, max(0.05, within_m), max(0.5, within_deg))
    request = SceneRequest(scenes, frames, topic_names(topics or ()) or {}, truth)
    with show_progress(quiet=quiet) as observe:
        found = run_presets(
            name,
            READERS[name](path, request),
            presets or tuple(PRESETS),
            out or Path("recordings") / "runs" / name,
            limits,
            target=target or "",
            settings=settings or (),
            observe=observe,
        )
    if as_json:
        typer.echo(found.model_dump_json(indent=2))
    else:
        print_dataset(found, stdout_console(quiet=quiet))
