# SPDX-License-Identifier: Apache-2.0
"""`multilica demo`: calibration of the embedded sample."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from multilica_cli.exit_codes import exit_code
from multilica_cli.options import Quiet, output

SAMPLE_NAME = "edgar-street"


def demo(
    *,
    out: Annotated[Path, output("--out DIR", "Directory for the results.")] = Path("recordings/runs/demo"),
    quiet: Quiet = False,
) -> int:
    """Calibrate the embedded sample and compare the result with the ground truth."""
    from multilica.config import preset
    from multilica.exports import read_extrinsics
    from multilica.run import run_calibration
    from multilica_cli.progress import show_progress
    from multilica_cli.tables.result import print_run

    sample = find_sample()
    with show_progress(quiet=quiet) as observe:
        run = run_calibration(sample.recording, out, preset("default"), observe=observe)
    print_run(run, read_extrinsics(sample.truth), quiet=quiet)
    return exit_code(run)


@dataclass(frozen=True, slots=True)
class Sample:
    """A simulated MCAP file with a TOML file of its exact extrinsics."""

    recording: Path
    truth: Path


def find_sample() -> Sample:
    """Find the embedded sample in the installed package or in the checkout.

    Raises:
        FileNotFoundError: it is in neither.
    """
    package = Path(__file__).parents[1]
    folders = (package / "samples", package.parents[1] / "recordings" / "samples")
    for folder in folders:
        sample = Sample(folder / f"{SAMPLE_NAME}.mcap", folder / f"{SAMPLE_NAME}.truth.toml")
        if sample.recording.is_file() and sample.truth.is_file():
            return sample
    raise FileNotFoundError(2, "the embedded sample is missing; `make sample` creates it", str(folders[-1]))
