# SPDX-License-Identifier: Apache-2.0
"""The TOML table of extrinsics without the figures of a run."""

from pathlib import Path

from multilica.extrinsics import Extrinsics, extrinsics_table, read_extrinsics
from multilica.sinks.files.result_files import toml_text
from multilica.sinks.text.extrinsics_text import child_poses


def toml_extrinsics(extrinsics: Extrinsics) -> str:
    """Return the table with a pose per frame."""
    poses = {pose.source: pose for pose in child_poses(extrinsics)}
    return toml_text(extrinsics_table(Extrinsics(extrinsics.target, poses)))


def read_toml(path: Path) -> Extrinsics:
    """Read the placed LiDARs of a table."""
    return read_extrinsics(path)
