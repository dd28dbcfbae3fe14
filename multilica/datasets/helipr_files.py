# SPDX-License-Identifier: Apache-2.0
"""The files of a HeLiPR sequence.

Layouts as the data set's own tools have them (HeLiPR-File-Player, HeLiPR-Pointcloud-Toolbox): packed little-endian
records without a header, in files that are named after their time in nanoseconds.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from multilica.datasets.trajectory import Stamps
from multilica.errors import InputError, SourceNotFoundError, UnreadableSourceError
from multilica.ingest.point_files.point_table import PointTable
from multilica.pointcloud2 import PointField
from multilica.snapshot import Scan

LIDARS = ("Ouster", "Velodyne", "Avia", "Aeva")
"""Names of the folders below ``LiDAR/``, the reference first."""
LAST_SHORT_AEVA_NS = 1_691_936_557_946_849_179
"""Later scans of the Aeva have an intensity after each point."""
_FARTHEST_M = 1e4
_PLAUSIBLE_SHARE = 0.9
"""As for KITTI's files: of random bytes, seven in eight are no coordinates."""
_FLOAT32, _UINT8 = 7, 2
_XYZ = tuple(PointField(axis, 4 * index, _FLOAT32) for index, axis in enumerate("xyz"))


def _layout(point_bytes: int, intensity: PointField) -> PointTable:
    return PointTable((*_XYZ, intensity), row_bytes=point_bytes)


_REFLECTIVITY = PointField("intensity", 12, _FLOAT32)
_LAYOUTS: Mapping[str, PointTable] = {
    "Ouster": _layout(26, _REFLECTIVITY),  # then t, reflectivity, ring, ambient
    "Velodyne": _layout(22, _REFLECTIVITY),  # then ring, time
    "Avia": _layout(19, PointField("intensity", 12, _UINT8)),  # then tag, line, offset_time
    "Aeva": _layout(25, _REFLECTIVITY),  # then velocity, time_offset_ns, line_index
}
_LONG_AEVA = _layout(29, PointField("intensity", 25, _FLOAT32))


def point_layout(lidar: str, stamp_ns: int) -> PointTable:
    """Return the layout of the points of a LiDAR at a time, without a number of rows."""
    return _LONG_AEVA if lidar == "Aeva" and stamp_ns > LAST_SHORT_AEVA_NS else _LAYOUTS[lidar]


@dataclass(frozen=True, slots=True, eq=False)
class ScanFiles:
    """The scans of one LiDAR; `stamps_ns` (N,) is increasing."""

    lidar: str
    folder: Path
    stamps_ns: Stamps

    def read(self, stamp_ns: int) -> Scan:
        """Read the scan of a stamp.

        Raises:
            UnreadableSourceError: the file is empty, cut off, or of another layout.
        """
        path = self.folder / f"{stamp_ns}.bin"
        layout = point_layout(self.lidar, stamp_ns)
        try:
            data = path.read_bytes()
        except OSError as error:
            raise UnreadableSourceError(f"{path} cannot be read: {error.strerror}.") from error
        if not data or len(data) % layout.row_bytes:
            raise UnreadableSourceError(
                f"{path} has {len(data)} bytes; expected points of {layout.row_bytes} bytes each, as HeLiPR's "
                f"{self.lidar} has them at that time."
            )
        table = PointTable(layout.fields, len(data) // layout.row_bytes, layout.row_bytes)
        points_m, intensity = table.read_records(memoryview(data))
        if np.count_nonzero(np.abs(points_m) < _FARTHEST_M) < _PLAUSIBLE_SHARE * 3 * table.rows:
            raise UnreadableSourceError(f"{path} has no coordinates where HeLiPR's {self.lidar} has them.")
        return Scan(points_m, stamp_ns, intensity, stamp_ns)


def find_sequence(path: Path) -> Path:
    """Return the folder of a sequence, the one that has ``LiDAR/``: the given one, or the only one below it.

    Raises:
        SourceNotFoundError: the path does not exist.
        InputError: there is no such folder, or several.
    """
    if not path.is_dir():
        raise SourceNotFoundError(f"No folder at {path}; give the folder of a HeLiPR sequence.")
    found = [folder for folder in (path, *sorted(path.iterdir())) if (folder / "LiDAR").is_dir()]
    if not found:
        raise InputError(f"{path} is not a HeLiPR sequence: it has no folder LiDAR with {', '.join(LIDARS)}.")
    if found[0] != path and len(found) > 1:
        raise InputError(f"{path} holds several sequences ({', '.join(each.name for each in found)}); give one.")
    return found[0]


def find_scan_files(sequence: Path) -> dict[str, ScanFiles]:
    """Return the scans of each LiDAR of a sequence, in the order of `LIDARS`.

    Raises:
        InputError: fewer than two LiDARs have scans.
    """
    found = {}
    for lidar in LIDARS:
        folder = sequence / "LiDAR" / lidar
        names = [path.stem for path in folder.glob("*.bin")]
        stamps_ns = np.array(sorted(int(name) for name in names if name.isdecimal()), np.int64)
        if len(stamps_ns):
            found[lidar] = ScanFiles(lidar, folder, stamps_ns)
    if len(found) < 2:
        raise InputError(
            f"{sequence} has scans of {', '.join(found) or 'no LiDAR'}; expected files LiDAR/NAME/STAMP.bin of at "
            f"least two of {', '.join(LIDARS)}."
        )
    return found
