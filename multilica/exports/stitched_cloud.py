# SPDX-License-Identifier: Apache-2.0
"""The clouds of all LiDARs in one frame, a colour per LiDAR, as PCD, PLY or LAS."""

from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
import numpy.typing as npt

from multilica.config import IngestConfig
from multilica.errors import InputError, SourceNotFoundError
from multilica.geometry import RigidTransform
from multilica.ingest import read_snapshot
from multilica.optional_libraries import needed_for
from multilica.sinks.drawing import distinct_colours
from multilica.sinks.files.result_files import MCAP

_LAS_SCALE_M = 1e-4


StitchedCloud = npt.NDArray[np.void]
"""Points of several LiDARs in one frame: position in metres, colour, and index of the LiDAR."""
_POINT = np.dtype([("xyz", "<f8", 3), ("rgb", "u1", 3), ("lidar", "u1")])


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
    clouds = []
    for name in sorted(poses):
        points_m = poses[name].apply(snapshot[name].points_m)
        clouds.append(np.empty(len(points_m), _POINT))
        clouds[-1]["xyz"], clouds[-1]["rgb"], clouds[-1]["lidar"] = points_m, colours[name], [*names].index(name)
    return np.concatenate(clouds)


def cloud_content(cloud: StitchedCloud, kind: str) -> bytes:
    """Return the content of a file of a kind of `CLOUD_FORMATS`."""
    return {"pcd": _pcd, "ply": _ply, "las": _las}[kind](cloud)


def _pcd(cloud: StitchedCloud) -> bytes:
    """Return a binary PCD file with colours packed as PCL does, ``0x00RRGGBB``."""
    count = len(cloud)
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\n"
        f"COUNT 1 1 1 1\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA binary\n"
    )
    rows = np.zeros(count, dtype=[("xyz", "<f4", 3), ("rgb", "<u4")])
    rows["xyz"] = cloud["xyz"]
    red, green, blue = cloud["rgb"].astype(np.uint32).T
    rows["rgb"] = red << 16 | green << 8 | blue
    return header.encode() + rows.tobytes()


def _ply(cloud: StitchedCloud) -> bytes:
    """Return a binary PLY file."""
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(cloud)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar lidar\nend_header\n"
    )
    rows = cloud.astype([("xyz", "<f4", 3), ("rgb", "u1", 3), ("lidar", "u1")])
    return header.encode() + rows.tobytes()


def _las(cloud: StitchedCloud) -> bytes:
    """Return a LAS 1.2 file; the source of a point is the index of its LiDAR, from 1."""
    with needed_for("Writing a LAS file", "laspy"):
        import laspy

    header = laspy.LasHeader(point_format=2, version="1.2")
    header.scales = np.full(3, _LAS_SCALE_M)
    header.generating_software = "multilica"
    las = laspy.LasData(header)
    las.x, las.y, las.z = cloud["xyz"].T
    las.red, las.green, las.blue = cloud["rgb"].T.astype(np.uint16) * 257
    las.point_source_id = cloud["lidar"].astype(np.uint16) + 1
    content = BytesIO()
    las.write(content)
    return content.getvalue()
