# SPDX-License-Identifier: Apache-2.0
"""Export of extrinsics and of saved runs."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from multilica.errors import UnknownNameError, UsageError
from multilica.exports.autoware import updated_autoware
from multilica.exports.formats import CLOUD_FORMATS, FORMATS, format_named
from multilica.exports.run_rig import FrameNames, rig_of_run
from multilica.exports.urdf import updated_urdf
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.ingest.remote.address import local_output
from multilica.runs.run_documents import read_run_document
from multilica.sinks.files.atomic import atomic_file

_UPDATES: Mapping[str, Callable[[Path, Extrinsics], bytes]] = {"urdf": updated_urdf, "autoware": updated_autoware}


@dataclass(frozen=True, slots=True, eq=False)
class RunExport:
    """An export of a run.

    Args:
        base: the common frame.
        lidars: the LiDARs that it holds.
        missing: the others of the run, with their status.
        uncertain: LiDARs that it holds although they are uncertain.
    """

    path: Path
    base: str
    lidars: tuple[str, ...]
    missing: Mapping[str, str]
    uncertain: tuple[str, ...]

    @property
    def complete(self) -> bool:
        """True if every LiDAR of the run is placed."""
        return not self.missing and not self.uncertain


def export_extrinsics(
    extrinsics: Extrinsics,
    path: str | Path,
    format: str,  # noqa: A002 - the word of the command line
) -> Path:
    """Write extrinsics into a file; in an existing URDF or Autoware file, only the poses of these frames change.

    Raises:
        UnknownNameError: there is no such format.
        UsageError: the name of the file does not fit the format, or it is an address.
        InputError: an existing URDF file lacks the joint of a frame.
    """
    found, file = format_named(format), _local(path)
    found.suffix_of(file)
    update = _UPDATES.get(found.name) if file.exists() else None
    _write(file, found.content(extrinsics, file) if update is None else update(file, extrinsics))
    return file


def export_run(
    run: str | Path,
    path: str | Path,
    format: str,  # noqa: A002 - the word of the command line
    *,
    base: str | None = None,
    rig: str | Path | None = None,
    frames: FrameNames = "names",
    with_uncertain: bool = False,
) -> RunExport:
    """Write the poses of a saved run into a file, or its stitched cloud; see `rig_of_run` for the arguments.

    Raises:
        SourceNotFoundError: there is no such run, or it has no clouds.
        UnreadableSourceError: the run or the rig is damaged.
        UnknownNameError: there is no such format or frame.
        UsageError: the name of the file does not fit the format, or it is an address.
        InputError: nothing is placed, or an existing URDF file lacks the joint of a LiDAR.
    """
    if format not in (*FORMATS, *CLOUD_FORMATS):
        raise UnknownNameError("format", format, (*FORMATS, *CLOUD_FORMATS))
    run, file = Path(run), _local(path)
    document = read_run_document(run).document
    known = () if document.ground is None else (document.ground.frame,)
    if format == "urdf" and file.exists() and base not in (None, *known) and rig is None:
        raise UsageError(f"{file} exists and has its own frames; give --base together with --rig, or without a file.")
    found, frame_of = rig_of_run(
        document, base=base, rig=None if rig is None else Path(rig), frames=frames, with_uncertain=with_uncertain
    )
    if format in FORMATS:
        export_extrinsics(found, file, format)
    else:
        poses = {lidar: found.between(found.target, frame) for lidar, frame in frame_of.items()}
        _export_cloud(run, file, format, poses, tuple(document.lidars))
    uncertain = tuple(name for name in frame_of if not document.lidars[name].placed)
    missing = {name: entry.status for name, entry in document.lidars.items() if name not in frame_of}
    return RunExport(file, found.target, tuple(frame_of), missing, uncertain)


def _export_cloud(run: Path, file: Path, kind: str, poses: Mapping[str, RigidTransform], names: Sequence[str]) -> None:
    from multilica.exports.stitched_cloud import cloud_content, read_stitched_cloud

    if file.suffix != f".{kind}":
        raise UsageError(f"Found --out {file} for the format {kind}; expected a name that ends in .{kind}.")
    _write(file, cloud_content(read_stitched_cloud(run, poses, names), kind))


def _local(path: str | Path) -> Path:
    file = local_output(path, "--out")
    if not file.parent.is_dir():
        raise UsageError(f"There is no directory {file.parent} for --out {file}; create it first.")
    return file


def _write(file: Path, content: bytes) -> None:
    with atomic_file(file) as opened:
        opened.write(content)
