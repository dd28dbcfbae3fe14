# SPDX-License-Identifier: Apache-2.0
"""A moment of a data set."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

from multilica.errors import UsageError
from multilica.extrinsics import Extrinsics
from multilica.snapshot import Snapshot


@dataclass(frozen=True, slots=True, eq=False)
class DatasetScene:
    """The scans of a vehicle that stands still, with the truth.

    Args:
        name: unique in the data set, and valid as the name of a folder.
        truth: None if the data set has none.
        target: the LiDAR that the data set's truth or the paper refers to; empty: the calibration chooses.
    """

    name: str
    snapshot: Snapshot
    truth: Extrinsics | None
    target: str = ""


@dataclass(frozen=True, slots=True)
class SceneRequest:
    """Which scenes to read.

    Args:
        scenes: largest number of scenes.
        frames: frames per LiDAR and scene.
        topics: LiDAR name -> its topic in recordings.
        truth: file with the truth of all scenes; None: the data set's own.

    Raises:
        UsageError: no scene, or no frame.
    """

    scenes: int = 10
    frames: int = 5
    topics: Mapping[str, str] = field(default_factory=dict)
    truth: Path | None = None

    def __post_init__(self) -> None:
        if self.scenes < 1 or self.frames < 1:
            raise UsageError(f"Found {self.scenes} scenes of {self.frames} frames; expected at least one of each.")


Reader: TypeAlias = Callable[[Path, SceneRequest], Iterator[DatasetScene]]
"""A function that yields the scenes of a data set.

Raises:
    SourceNotFoundError: the path does not exist.
    InputError: it does not hold that data set, a file of it is damaged, or it has no moment of standstill.
"""
