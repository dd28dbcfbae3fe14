# SPDX-License-Identifier: Apache-2.0
"""The recording that comes with multilica."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

__all__ = ["SAMPLE_NAME", "Sample", "find_sample"]

SAMPLE_NAME = "edgar-street"


@dataclass(frozen=True, slots=True)
class Sample:
    """A simulated snapshot.

    Args:
        recording: the MCAP file.
        truth: TOML file of the exact extrinsics.
    """

    recording: Path
    truth: Path


def find_sample() -> Sample:
    """The embedded sample: in the installed package, or in the checkout that this file belongs to.

    Raises:
        FileNotFoundError: in neither.
    """
    package = Path(__file__).parent
    folders = (package / "samples", package.parents[1] / "recordings" / "samples")
    for folder in folders:
        sample = Sample(folder / f"{SAMPLE_NAME}.mcap", folder / f"{SAMPLE_NAME}.truth.toml")
        if sample.recording.is_file() and sample.truth.is_file():
            return sample
    raise FileNotFoundError(2, "the embedded sample is missing; `make sample` makes it", str(folders[-1]))
