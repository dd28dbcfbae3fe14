# SPDX-License-Identifier: Apache-2.0
"""Scenes of the HeLiPR data set (Jung et al. 2023), from the moments at which its vehicle stands still."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from multilica.config import StillnessConfig
from multilica.datasets.helipr_files import LIDARS, ScanFiles, find_scan_files, find_sequence
from multilica.datasets.scene import DatasetScene, SceneRequest
from multilica.datasets.standstill import stops_by_poses, stops_by_scans
from multilica.datasets.trajectory import Trajectory, read_trajectory
from multilica.datasets.truth_files import read_truth
from multilica.errors import UnfitSnapshotError
from multilica.extrinsics import Extrinsics
from multilica.snapshot import LidarScans, Scan, Snapshot
from multilica.stages.stillness import detect_motion

_PERIOD_NS = 100_000_000
"""All four LiDARs scan at 10 Hz."""


def read_scenes(path: Path, request: SceneRequest) -> Iterator[DatasetScene]:
    """Yield a scene per stop of a sequence, oldest first, of the longest stops.

    Stops come from the poses of ``LiDAR_GT``, else from the scans of the reference LiDAR, which also confirm each stop.
    The truth is the pose of each LiDAR in ``LiDAR_GT`` relative to the reference LiDAR at that moment, as in the paper.

    Raises:
        SourceNotFoundError: the path does not exist.
        InputError: it is not a sequence, a file is damaged, or the vehicle never stands still.
    """
    sequence = find_sequence(path)
    files = find_scan_files(sequence)
    trajectories = _read_trajectories(sequence, files)
    given = None if request.truth is None else read_truth(request.truth)
    length_ns = (request.frames + 1) * _PERIOD_NS
    for start_ns in _moments(files, trajectories, length_ns, request, sequence):
        truth = given or _truth(trajectories, start_ns + length_ns // 2)
        snapshot = _snapshot(files, start_ns, length_ns, request.frames, sequence)
        yield DatasetScene(str(start_ns), snapshot, truth, _reference(files))


def _reference(files: Mapping[str, ScanFiles]) -> str:
    return next(iter(files))


def _read_trajectories(sequence: Path, files: Mapping[str, ScanFiles]) -> dict[str, Trajectory]:
    paths = {lidar: sequence / "LiDAR_GT" / f"{lidar}_gt.txt" for lidar in files}
    return {lidar: read_trajectory(path, lidar) for lidar, path in paths.items() if path.is_file()}


def _moments(
    files: Mapping[str, ScanFiles],
    trajectories: Mapping[str, Trajectory],
    length_ns: int,
    request: SceneRequest,
    sequence: Path,
) -> list[int]:
    """Return the start stamps of the scenes, oldest first."""
    reference = files[_reference(files)]
    followed = next((trajectories[lidar] for lidar in LIDARS if lidar in trajectories), None)

    def read(stamps_ns: Iterable[int]) -> list[Scan]:
        return [reference.read(stamp_ns) for stamp_ns in stamps_ns]

    if followed is not None:
        stops = stops_by_poses(followed, length_ns)
    else:
        stops = stops_by_scans(reference.stamps_ns, read, length_ns)
    confirmed: list[int] = []
    for start_ns in stops:
        scans = read(_stamps(reference, start_ns, length_ns, request.frames))
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


def _stamps(files: ScanFiles, start_ns: int, length_ns: int, frames: int) -> list[int]:
    inside = files.stamps_ns[(files.stamps_ns >= start_ns) & (files.stamps_ns < start_ns + length_ns)]
    return [int(stamp_ns) for stamp_ns in inside[:frames]]


def _snapshot(files: Mapping[str, ScanFiles], start_ns: int, length_ns: int, frames: int, sequence: Path) -> Snapshot:
    lidars, notes = [], []
    for lidar, scans in files.items():
        stamps_ns = _stamps(scans, start_ns, length_ns, frames)
        if stamps_ns:
            lidars.append(LidarScans(lidar, tuple(map(scans.read, stamps_ns)), topic=f"/{lidar.lower()}/points"))
        if len(stamps_ns) < frames:
            notes.append(f"{lidar} has {len(stamps_ns)} of {frames} scans from {start_ns} on.")
    return Snapshot(tuple(lidars), f"{sequence} at {start_ns}", notes=tuple(notes))


def _truth(trajectories: Mapping[str, Trajectory], stamp_ns: int) -> Extrinsics | None:
    poses = {lidar: pose for lidar, path in trajectories.items() if (pose := path.pose_at(stamp_ns)) is not None}
    if len(poses) < 2:
        return None
    reference = next(iter(poses))
    T_reference_world = poses[reference].inverse()
    return Extrinsics(reference, {lidar: T_reference_world @ pose for lidar, pose in poses.items()})
