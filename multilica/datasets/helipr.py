# SPDX-License-Identifier: Apache-2.0
"""Scenes of the HeLiPR data set (Jung et al. 2023), from the moments at which its vehicle stands still.

Layouts of its files as the data set's own tools have them (HeLiPR-File-Player, HeLiPR-Pointcloud-Toolbox): packed
little-endian records without a header, in files that are named after their time in nanoseconds.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation, Slerp

from multilica.config import StillnessConfig
from multilica.datasets.scene import DatasetScene, SceneRequest, read_truth
from multilica.errors import InputError, SourceNotFoundError, UnfitSnapshotError, UnreadableSourceError
from multilica.extrinsics import Extrinsics
from multilica.geometry import FloatArray, RigidTransform
from multilica.ingest.point_files.tables import PointTable
from multilica.pointcloud2 import PointField
from multilica.snapshot import LidarScans, Scan, Snapshot
from multilica.stages.stillness import detect_motion

Stamps = npt.NDArray[np.int64]
LIDARS = ("Ouster", "Velodyne", "Avia", "Aeva")
"""Names of the folders below ``LiDAR/``, the reference first."""
LAST_SHORT_AEVA_NS = 1_691_936_557_946_849_179
"""Later scans of the Aeva have an intensity after each point."""
_FARTHEST_M = 1e4
_PLAUSIBLE_SHARE = 0.9
"""As for KITTI's files: of random bytes, seven in eight are no coordinates."""
_FLOAT32, _UINT16, _UINT8 = 7, 4, 2
_XYZ = tuple(PointField(axis, 4 * index, _FLOAT32) for index, axis in enumerate("xyz"))
_REFLECTIVITY = PointField("intensity", 12, _FLOAT32)
_LINE = PointField("ring", 24, _UINT8)
_LAYOUTS: Mapping[str, tuple[int, tuple[PointField, ...]]] = {
    "Ouster": (26, (_REFLECTIVITY, PointField("ring", 22, _UINT16))),  # between t, reflectivity and ambient
    "Velodyne": (22, (_REFLECTIVITY, PointField("ring", 16, _UINT16))),  # then time
    "Avia": (19, (PointField("intensity", 12, _UINT8), PointField("ring", 14, _UINT8))),  # between tag and offset_time
    "Aeva": (25, (_REFLECTIVITY, _LINE)),  # between them velocity, time_offset_ns
}
_LONG_AEVA = (29, (PointField("intensity", 25, _FLOAT32), _LINE))
"""Bytes of a point, and the places of its intensity and ring; x, y and z begin each point."""


def point_layout(lidar: str, stamp_ns: int) -> PointTable:
    """Return the layout of the points of a LiDAR at a time, without a number of rows."""
    is_long = lidar == "Aeva" and stamp_ns > LAST_SHORT_AEVA_NS
    point_bytes, fields = _LONG_AEVA if is_long else _LAYOUTS[lidar]
    return PointTable((*_XYZ, *fields), row_bytes=point_bytes)


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
        table = replace(layout, rows=len(data) // layout.row_bytes)
        points = table.read_records(memoryview(data))
        if np.count_nonzero(np.abs(points.points_m) < _FARTHEST_M) < _PLAUSIBLE_SHARE * 3 * table.rows:
            raise UnreadableSourceError(f"{path} has no coordinates where HeLiPR's {self.lidar} has them.")
        return replace(points.as_scan(stamp_ns), log_time_ns=stamp_ns)

    def read_from(self, start_ns: int, length_ns: int, frames: int) -> tuple[Scan, ...]:
        """Read the scans from a stamp on, for that long and at most as many as `frames`; errors as of `read`."""
        inside = self.stamps_ns[(self.stamps_ns >= start_ns) & (self.stamps_ns < start_ns + length_ns)]
        return tuple(self.read(int(stamp_ns)) for stamp_ns in inside[:frames])


def _find_sequence(path: Path) -> Path:
    """Return the folder of a sequence, the one that has ``LiDAR/``: the given one, or the only one below it."""
    if not path.is_dir():
        raise SourceNotFoundError(f"No folder at {path}; give the folder of a HeLiPR sequence.")
    found = [folder for folder in (path, *sorted(path.iterdir())) if (folder / "LiDAR").is_dir()]
    if not found:
        raise InputError(f"{path} is not a HeLiPR sequence: it has no folder LiDAR with {', '.join(LIDARS)}.")
    if found[0] != path and len(found) > 1:
        raise InputError(f"{path} holds several sequences ({', '.join(each.name for each in found)}); give one.")
    return found[0]


def _find_scan_files(sequence: Path) -> dict[str, ScanFiles]:
    """Return the scans of each LiDAR of a sequence, two or more, in the order of `LIDARS`."""
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


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses ``T_world_<lidar>``, oldest first.

    Args:
        stamps_ns: (N,) increasing.
        xyz_m: (N, 3).
        rotations: N of them.
    """

    lidar: str
    stamps_ns: Stamps
    xyz_m: FloatArray
    rotations: Rotation

    def pose_at(self, stamp_ns: int) -> RigidTransform | None:
        """Interpolate ``T_world_<lidar>``; None before the first and after the last pose."""
        if not self.stamps_ns[0] <= stamp_ns <= self.stamps_ns[-1]:
            return None
        # Relative to the stamp: nanoseconds since 1970 exceed the precision of a float.
        after = int(np.clip(np.searchsorted(self.stamps_ns, stamp_ns), 1, len(self.stamps_ns) - 1))
        two = slice(after - 1, after + 1)
        times = (self.stamps_ns[two] - stamp_ns).astype(np.float64)
        xyz_m = [float(np.interp(0.0, times, axis)) for axis in self.xyz_m[two].T]
        rotation = Slerp(times, self.rotations[two])(0.0)
        return RigidTransform.from_rotation_translation("world", self.lidar, rotation.as_matrix(), xyz_m)


def _read_trajectory(path: Path, lidar: str) -> Trajectory:
    """Read lines ``stamp_ns x y z qx qy qz qw`` with increasing stamps, two or more."""
    try:
        lines = [line.split() for line in path.read_text(encoding="ascii").splitlines() if line.strip()]
        stamps_ns = np.array([int(words[0]) for words in lines], np.int64)
        values = np.array([[float(word) for word in words[1:8]] for words in lines], np.float64)
        if values.ndim != 2 or values.shape[0] < 2 or values.shape[1] != 7 or not np.isfinite(values).all():
            raise ValueError(f"{len(lines)} lines that are not poses")  # noqa: TRY301 - told with the path
        if not np.all(np.diff(stamps_ns) > 0):
            raise ValueError("time stamps that do not increase")  # noqa: TRY301
        return Trajectory(lidar, stamps_ns, values[:, :3], Rotation.from_quat(values[:, 3:]))
    except (OSError, OverflowError, ValueError) as error:
        found = " ".join(str(error).split()).rstrip(".")
        raise UnreadableSourceError(
            f"{path} is not a trajectory ({found}); expected lines of stamp in ns, x, y, z, qx, qy, qz, qw."
        ) from error


_LOOKS_EVERY_NS = 2_000_000_000
"""A stop that matters is longer than this."""


def stops_by_poses(trajectory: Trajectory, length_ns: int) -> list[int]:
    """Find the stops at which the poses stay within the limits of `StillnessConfig` for that long.

    Returns:
        A start stamp per stop, from its middle, the longest stop first.
    """
    limits = StillnessConfig()
    stamps_ns = trajectory.stamps_ns
    still = stamps_ns + length_ns <= stamps_ns[-1]
    still[:-1] &= np.diff(stamps_ns) <= length_ns  # in a gap, nothing is known
    for step in range(1, len(stamps_ns)):
        span_ns = stamps_ns[step:] - stamps_ns[:-step]
        inside = span_ns <= length_ns
        if not inside.any():
            break
        shift_m: FloatArray = np.linalg.norm(trajectory.xyz_m[step:] - trajectory.xyz_m[:-step], axis=1)
        turn_rad = (trajectory.rotations[:-step].inv() * trajectory.rotations[step:]).magnitude()
        moved = (shift_m > limits.max_shift_m) | (turn_rad > np.deg2rad(limits.max_rotation_deg))
        still[:-step] &= ~(inside & moved)
    return _middles(stamps_ns, still)


def stops_by_scans(stamps_ns: Stamps, read: Callable[[Iterable[int]], Sequence[Scan]], length_ns: int) -> list[int]:
    """Find the stops at which the scans of one LiDAR show no motion for that long, by looking every two seconds.

    Returns:
        A start stamp per stop, from its middle, the longest stop first.
    """
    starts, still = [], []
    next_ns = int(stamps_ns[0])
    for start_ns in map(int, stamps_ns):
        inside = stamps_ns[(stamps_ns >= start_ns) & (stamps_ns <= start_ns + length_ns)]
        if start_ns < next_ns or len(inside) < 2:
            continue
        next_ns = start_ns + _LOOKS_EVERY_NS
        motion = detect_motion(read(map(int, inside[[0, len(inside) // 2, -1]])), StillnessConfig())
        starts.append(start_ns)
        still.append(motion.observable and not motion.moving)
    return _middles(np.array(starts, np.int64), np.array(still, bool))


def _middles(stamps_ns: Stamps, still: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> list[int]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    stops = [(int(first), int(last) - 1) for first, last in edges.reshape(-1, 2)]
    stops.sort(key=lambda stop: (int(stamps_ns[stop[0]] - stamps_ns[stop[1]]), stop))
    return [int(stamps_ns[(first + last) // 2]) for first, last in stops]


_PERIOD_NS = 100_000_000
"""All four LiDARs scan at 10 Hz."""


def read_scenes(path: Path, request: SceneRequest) -> Iterator[DatasetScene]:
    """Yield a scene per stop of a sequence, oldest first, of the longest stops.

    Stops come from the poses of ``LiDAR_GT``, else from the scans of the reference LiDAR, which also confirm each stop.
    The truth is the pose of each LiDAR in ``LiDAR_GT`` relative to the reference LiDAR at that moment, as in the paper;
    without poses of the reference, relative to the first LiDAR that has some.

    Raises:
        SourceNotFoundError: the path does not exist.
        InputError: it is not a sequence, a file is damaged, or the vehicle never stands still.
    """
    sequence = _find_sequence(path)
    files = _find_scan_files(sequence)
    paths = {lidar: sequence / "LiDAR_GT" / f"{lidar}_gt.txt" for lidar in files}
    trajectories = {lidar: _read_trajectory(path, lidar) for lidar, path in paths.items() if path.is_file()}
    given = None if request.truth is None else read_truth(request.truth)
    length_ns = (request.frames + 1) * _PERIOD_NS
    for start_ns in _moments(files, trajectories, length_ns, request, sequence):
        truth = given or _truth(trajectories, start_ns + length_ns // 2)
        snapshot = _snapshot(files, start_ns, length_ns, request.frames, sequence)
        reference, *_ = files
        target = next((lidar for lidar in files if truth is None or lidar in truth.members), reference)
        if target != reference:
            note = f"The truth has no pose of {reference}: {target} is the target, to which errors refer."
            snapshot = replace(snapshot, notes=(*snapshot.notes, note))
        yield DatasetScene(str(start_ns), snapshot, truth, target)


def _moments(
    files: Mapping[str, ScanFiles],
    trajectories: Mapping[str, Trajectory],
    length_ns: int,
    request: SceneRequest,
    sequence: Path,
) -> list[int]:
    """Return the start stamps of the scenes, oldest first."""
    reference = next(iter(files.values()))
    followed = next((trajectories[lidar] for lidar in LIDARS if lidar in trajectories), None)
    if followed is not None:
        stops = stops_by_poses(followed, length_ns)
    else:
        stops = stops_by_scans(reference.stamps_ns, lambda wanted: [*map(reference.read, wanted)], length_ns)
    confirmed: list[int] = []
    for start_ns in stops:
        scans = reference.read_from(start_ns, length_ns, request.frames)
        if scans and not detect_motion(scans, StillnessConfig()).moving:
            confirmed.append(start_ns)
        if len(confirmed) == request.scenes:
            break
    if not confirmed:
        raise UnfitSnapshotError(
            f"The vehicle of {sequence} never stands still for {length_ns * 1e-9:.1f} s; choose a sequence with a "
            "stop, or fewer frames.",
            "moving_vehicle",
        )
    return sorted(confirmed)


def _snapshot(files: Mapping[str, ScanFiles], start_ns: int, length_ns: int, frames: int, sequence: Path) -> Snapshot:
    lidars, notes = [], []
    for lidar, scan_files in files.items():
        scans = scan_files.read_from(start_ns, length_ns, frames)
        if scans:
            lidars.append(LidarScans(lidar, scans, topic=f"/{lidar.lower()}/points"))
        if len(scans) < frames:
            notes.append(f"{lidar} has {len(scans)} of {frames} scans from {start_ns} on.")
    return Snapshot(tuple(lidars), f"{sequence} at {start_ns}", notes=tuple(notes))


def _truth(trajectories: Mapping[str, Trajectory], stamp_ns: int) -> Extrinsics | None:
    poses = {lidar: pose for lidar, path in trajectories.items() if (pose := path.pose_at(stamp_ns)) is not None}
    if len(poses) < 2:
        return None
    reference = next(iter(poses))
    T_reference_world = poses[reference].inverse()
    return Extrinsics(reference, {lidar: T_reference_world @ pose for lidar, pose in poses.items()})
