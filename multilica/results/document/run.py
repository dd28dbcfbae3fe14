# SPDX-License-Identifier: Apache-2.0
"""Input, progress, snapshots and ground in the result document."""

from collections.abc import Mapping

from pydantic import Field

from multilica.config import Stage
from multilica.results.document.values import Entry, Matrix4, Number, Vector3

__all__ = [
    "DeviationEntry",
    "GroundEntry",
    "InputEntry",
    "InputLidarEntry",
    "ProgressEntry",
    "RefusalEntry",
    "SnapshotEntry",
]


class InputLidarEntry(Entry):
    """A LiDAR of the input."""

    topic: str = Field(description="Topic in the recording; empty if there is none.")
    frame_id: str = Field(description="Frame of its messages; empty if there is none.")
    frames: int = Field(description="Number of frames.")
    points: int = Field(description="Number of points.")


class InputEntry(Entry):
    """The snapshot that was calibrated."""

    source: str = Field(description="File or address; empty for data in memory.")
    sha256: str = Field(description="Hash of the file; empty if it is not known.")
    lidars: Mapping[str, InputLidarEntry] = Field(description="Per LiDAR.")


class RefusalEntry(Entry):
    """Why the snapshot was not calibrated at all."""

    code: str = Field(description="Stable name, for programs.")
    text: str = Field(description="The reason for people.")


class ProgressEntry(Entry):
    """How far the run came."""

    finished: tuple[Stage, ...] = Field(description="Finished stages, in order.")
    running: Stage | None = Field(description="The stage that was running when the document was written.")


class DeviationEntry(Entry):
    """How far a snapshot by itself places a LiDAR from the joint result."""

    lidar: str = Field(description="Name of the LiDAR.")
    distance_m: float = Field(description="Distance.")
    angle_deg: float = Field(description="Angle.")
    outlier: bool = Field(description="Whether other snapshots outvoted this one.")


class SnapshotEntry(Entry):
    """The contribution of one snapshot to a joint result."""

    name: str = Field(description="Name of the snapshot.")
    source: str = Field(description="File or address.")
    sha256: str = Field(description="Hash of the file; empty if it is not known.")
    refusal: str | None = Field(description="Why the snapshot was left out; null if it was used.")
    outliers: tuple[str, ...] = Field(description="LiDARs on which other snapshots outvoted this one.")
    disputed: tuple[str, ...] = Field(description="LiDARs on which it contradicts other snapshots without a majority.")
    deviations: tuple[DeviationEntry, ...] = Field(description="Per LiDAR that it places.")


class GroundEntry(Entry):
    """The ground plane, seen from the target LiDAR."""

    normal: Vector3 = Field(description="Unit normal in the target frame, upwards.")
    offset_m: float = Field(description="Height of the target LiDAR above the ground.")
    T_base_target: Matrix4 = Field(
        description="Rows of the target's pose in a base frame on the ground below it; x, y and yaw are zero."
    )
    xyz_m: Vector3 = Field(description="Position of that pose.")
    rpy_deg: Vector3 = Field(description="Roll, pitch, yaw of that pose.")
    inlier_share: Number = Field(description="Share of the merged cloud that lies on the plane.")
