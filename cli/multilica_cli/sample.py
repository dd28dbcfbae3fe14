# SPDX-License-Identifier: Apache-2.0
"""Sample recording that is installed with multilica."""

from dataclasses import dataclass
from pathlib import Path

__all__ = ["SAMPLE_NAME", "Sample", "find_sample"]

SAMPLE_NAME = "edgar-street"


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
    package = Path(__file__).parent
    folders = (package / "samples", package.parents[1] / "recordings" / "samples")
    for folder in folders:
        sample = Sample(folder / f"{SAMPLE_NAME}.mcap", folder / f"{SAMPLE_NAME}.truth.toml")
        if sample.recording.is_file() and sample.truth.is_file():
            return sample
    raise FileNotFoundError(2, "the embedded sample is missing; `make sample` creates it", str(folders[-1]))
