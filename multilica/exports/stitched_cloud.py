# SPDX-License-Identifier: Apache-2.0
"""The clouds of all LiDARs in one frame, a colour per LiDAR, as PCD, PLY or LAS."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
import numpy.typing as npt

from multilica.config import IngestConfig
from multilica.errors import InputError, SourceNotFoundError
from multilica.geometry import FloatArray, RigidTransform
from multilica.ingest import read_snapshot
from multilica.optional_libraries import needed_for
from multilica.sinks.drawing.palette import distinct_colours
from multilica.sinks.files.run_files import MCAP

_LAS_SCALE_M = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class StitchedCloud:
    """Points (N, 3) of several LiDARs in one frame with colours (N, 3) and indices (N,) of their LiDARs."""

    points_m: FloatArray
    colours: npt.NDArray[np.uint8]
    lidar: npt.NDArray[np.uint8]


def read_stitched_cloud(run: Path, poses: Mapping[str, RigidTransform], names: Sequence[str]) -> StitchedCloud:
    """Read the clouds of a run's result.mcap and take them to the common frame.

    Args:
        poses: ``T_base_lidar`` by LiDAR.
        names: all LiDARs of the run, whose order gives the colours.

    Raises:
        SourceNotFoundError: the run has no result.mcap.
        InputError: it lacks the cloud of a LiDAR.
    """
    file = run if run.suffix == ".mcap" else (run if run.is_dir() else run.parent) / MCAP
    if not file.exists():
        raise SourceNotFoundError(f"{run} has no {MCAP}, which holds the clouds; calibrate again to write one.")
    snapshot = read_snapshot(file, config=IngestConfig(frames=1))
    missing = sorted({*poses} - {*snapshot.names})
    if missing:
        raise InputError(f"{file} has no cloud of '{missing[0]}'; calibrate again to write one.")
    colours = distinct_colours(names)
    clouds = {name: poses[name].apply(snapshot[name].points_m) for name in sorted(poses)}
    counts = [len(cloud) for cloud in clouds.values()]
    return StitchedCloud(
        np.concatenate(list(clouds.values())),
        np.repeat(np.array([colours[name] for name in clouds], dtype=np.uint8), counts, axis=0),
        np.repeat(np.array([[*names].index(name) for name in clouds], dtype=np.uint8), counts),
    )


def cloud_content(cloud: StitchedCloud, kind: str) -> bytes:
    """Return the content of a file of a kind of `CLOUD_FORMATS`."""
    return {"pcd": _pcd, "ply": _ply, "las": _las}[kind](cloud)


def _pcd(cloud: StitchedCloud) -> bytes:
    """Return a binary PCD file with colours packed as PCL does, ``0x00RRGGBB``."""
    count = len(cloud.points_m)
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\n"
        f"COUNT 1 1 1 1\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA binary\n"
    )
    rows = np.zeros(count, dtype=[("xyz", "<f4", 3), ("rgb", "<u4")])
    rows["xyz"] = cloud.points_m
    red, green, blue = cloud.colours.astype(np.uint32).T
    rows["rgb"] = red << 16 | green << 8 | blue
    return header.encode() + rows.tobytes()


def _ply(cloud: StitchedCloud) -> bytes:
    """Return a binary PLY file."""
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(cloud.points_m)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar lidar\nend_header\n"
    )
    rows = np.zeros(len(cloud.points_m), dtype=[("xyz", "<f4", 3), ("rgb", "u1", 3), ("lidar", "u1")])
    rows["xyz"], rows["rgb"], rows["lidar"] = cloud.points_m, cloud.colours, cloud.lidar
    return header.encode() + rows.tobytes()


def _las(cloud: StitchedCloud) -> bytes:
    """Return a LAS 1.2 file; the source of a point is the index of its LiDAR, from 1."""
    with needed_for("Writing a LAS file", "laspy"):
        import laspy

    header = laspy.LasHeader(point_format=2, version="1.2")
    header.scales = np.full(3, _LAS_SCALE_M)
    header.generating_software = "multilica"
    las = laspy.LasData(header)
    las.x, las.y, las.z = cloud.points_m.T
    las.red, las.green, las.blue = cloud.colours.T.astype(np.uint16) * 257
    las.point_source_id = cloud.lidar.astype(np.uint16) + 1
    content = BytesIO()
    las.write(content)
    return content.getvalue()
