# SPDX-License-Identifier: Apache-2.0
"""Static transforms in recordings."""

from contextlib import closing
from pathlib import Path

from multilica.exports.values import extrinsics_of_poses
from multilica.extrinsics import Extrinsics
from multilica.ingest.locate import find_source
from multilica.ingest.opening import open_source
from multilica.ingest.transforms.prior import read_static_transforms
from multilica.sinks.mcap.snapshot_mcap import static_transforms_mcap
from multilica.sinks.text.extrinsics_text import child_poses


def tf_static_mcap(extrinsics: Extrinsics) -> bytes:
    """Return a ROS 2 recording with `/tf_static`."""
    return static_transforms_mcap(child_poses(extrinsics))


def read_tf_static(path: Path) -> Extrinsics:
    """Read `/tf_static` of an MCAP file or ROS bag."""
    with closing(open_source(find_source(path))) as recording:
        poses, notes = read_static_transforms(recording)
    if notes:
        raise ValueError(notes[0].rstrip("."))
    return extrinsics_of_poses(poses)
