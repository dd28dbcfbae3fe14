# SPDX-License-Identifier: Apache-2.0
"""Files of extrinsics in any format, also of saved runs, in the frame and under the names that are asked for."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from multilica.documents import DocumentError, local_path
from multilica.errors import (
    InputError,
    MultilicaError,
    SourceNotFoundError,
    UnknownNameError,
    UnreadableSourceError,
    UsageError,
    listed,
)
from multilica.exports.formats import CLOUD_FORMATS, FORMATS, ExchangeFormat, format_named
from multilica.exports.ros_launch import EXECUTABLE
from multilica.exports.text_files import KALIBR_MATRIX, KITTI_LINE, toml_extrinsics, updated_autoware
from multilica.exports.urdf import updated_urdf
from multilica.exports.values import read_text, read_yaml
from multilica.extrinsics import Extrinsics, read_extrinsics_table, require_metres
from multilica.geometry import RigidTransform
from multilica.ingest.remote.address import local_output
from multilica.ingest.transforms import parse_xml
from multilica.results.document import GroundEntry, ResultDocument
from multilica.runs.run_documents import read_run_document
from multilica.sinks.files.atomic import atomic_file
from multilica.sinks.files.result_files import sensor_biases

FrameNames = Literal["names", "ids"]
_UPDATES: Mapping[str, Callable[[Path, Extrinsics], bytes]] = {"urdf": updated_urdf, "autoware": updated_autoware}


@dataclass(frozen=True, slots=True, eq=False)
class RunExport:
    """An export of a run: its common frame and LiDARs, some perhaps uncertain, and the missing ones by status.

    Args:
        without_covariance: LiDARs whose covariance the run has, but not in a common frame that has none itself.
    """

    path: Path
    base: str
    lidars: tuple[str, ...]
    missing: Mapping[str, str]
    uncertain: tuple[str, ...]
    without_covariance: tuple[str, ...] = ()

    @property
    def complete(self) -> bool:
        """True if every LiDAR of the run is placed."""
        return not self.missing and not self.uncertain


def read_extrinsics(path: str | Path, format: str | None = None, *, with_uncertain: bool = False) -> Extrinsics:  # noqa: A002 - the word of the command line
    """Read extrinsics from a file of any format of `multilica.exports.FORMATS`, or from a recording's `/tf_static`.

    If a file holds a tree of frames, the common frame is its root, and every frame is a member.

    Args:
        format: the format; by default the suffix and the content decide.
        with_uncertain: also take the LiDARs that `calibration.toml` lists as uncertain.

    Raises:
        SourceNotFoundError: no such file.
        UnreadableSourceError: it is broken, no tree of frames, or not of the format.
        UnknownNameError: there is no such format.
    """
    path = local_path(path)
    if format is not None:
        format_named(format)
    if not path.exists():
        raise SourceNotFoundError(f"No extrinsics file at {path}.")
    try:
        found = _told(path) if format is None else FORMATS[format]
        return read_extrinsics_table(path, with_uncertain=with_uncertain) if found.name == "toml" else found.read(path)
    except MultilicaError:
        raise
    except (DocumentError, ValueError) as error:
        raise UnreadableSourceError(f"{path} has no extrinsics that can be used: {error}.") from error
    except OSError as error:
        raise UnreadableSourceError(f"{path} cannot be read: {error.strerror or error}.") from error


def _told(path: Path) -> ExchangeFormat:
    """Recognise the format by the suffix, else by the content."""
    if path.is_dir():
        return FORMATS["tf-static"]
    named = [each for each in FORMATS.values() if path.suffix in each.readers]
    if len(named) == 1:
        return named[0]
    if path.suffix == ".xml":
        return FORMATS["urdf" if parse_xml(path, "launch or URDF").tag == "robot" else "ros2-launch"]
    if path.suffix in (".yaml", ".yml"):
        return FORMATS[_told_yaml(path)]
    text = read_text(path)
    if EXECUTABLE in text:
        return FORMATS["ros2-static"]
    return FORMATS["kitti" if KITTI_LINE.search(text) else "matrices"]


def _told_yaml(path: Path) -> str:
    document = read_yaml(path)
    if "launch" in document:
        return "ros2-launch"
    entries = [entry for entry in document.values() if isinstance(entry, dict)]
    return "kalibr" if any(KALIBR_MATRIX in entry for entry in entries) else "autoware"


def export_extrinsics(extrinsics: Extrinsics, path: str | Path, format: str) -> Path:  # noqa: A002 - the word of the command line
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
    if format == "toml":
        biases = {frame_of[lidar]: each for lidar, each in sensor_biases(document).items() if lidar in frame_of}
        format_named(format).suffix_of(file)
        _write(file, toml_extrinsics(found, biases).encode())
    elif format in FORMATS:
        export_extrinsics(found, file, format)
    else:
        poses = {lidar: found.between(found.target, frame) for lidar, frame in frame_of.items()}
        _export_cloud(run, file, format, poses, tuple(document.lidars))
    uncertain = tuple(name for name in frame_of if not document.lidars[name].placed)
    missing = {name: entry.status for name, entry in document.lidars.items() if name not in frame_of}
    lost = [
        name
        for name, frame in frame_of.items()
        if name in document.covariances and frame != found.target and frame not in found.covariances
    ]
    return RunExport(file, found.target, tuple(frame_of), missing, uncertain, tuple(lost) if format == "toml" else ())


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


def rig_of_run(
    document: ResultDocument,
    *,
    base: str | None = None,
    rig: Path | None = None,
    frames: FrameNames = "names",
    with_uncertain: bool = False,
) -> tuple[Extrinsics, dict[str, str]]:
    """Return the poses of the placed LiDARs of a run.

    Args:
        base: the common frame: a LiDAR, by its name or frame id, a frame of `rig`, or, without `rig`, the base frame on
            the ground that the run found, or another name of the target's frame; by default the common frame of `rig`,
            else the base frame of the run if a rig file gave it x, y and yaw, else the target's.
        rig: a file of extrinsics with the pose of the target in `base`, under its name or its frame id.
        frames: whether a LiDAR's frame has its name, or is the frame id of its messages.
        with_uncertain: also take the uncertain LiDARs, and a base frame that is uncertain.

    Returns:
        The poses by frame, in the base frame, and the frame of each LiDAR that has a pose, the target among them.

    Raises:
        InputError: only the target is placed, frame ids are missing or not unique, or the base frame is uncertain or
            that of a LiDAR without a pose.
        UnknownNameError: `rig` lacks the base frame or the target.
        UsageError: a frame cannot be named.
    """
    wanted = {name: pose for name, pose in document.poses.items() if with_uncertain or document.lidars[name].placed}
    if not {*wanted} - {document.target}:
        left_out = [name for name in document.poses if document.lidars[name].status == "uncertain"]
        more = f" without --with-uncertain, which adds {listed(left_out)}" if left_out and not with_uncertain else ""
        raise InputError(f"The run has no placed LiDAR besides the target, so there is nothing to export{more}.")
    named = {name: name for name in wanted} if frames == "names" else _frames_by_id(document, wanted)
    target = named[document.target]
    poses = {named[name]: RigidTransform(target, named[name], pose.matrix) for name, pose in wanted.items()}
    covariances = {named[name]: covariance for name, covariance in document.covariances.items() if name in wanted}
    others = {frame: pose for frame, pose in poses.items() if frame != target}
    found = Extrinsics(target, others, covariances=covariances)
    ground = None if rig is not None else _own_base(document, base, with_uncertain=with_uncertain)
    if ground is not None:
        T_base_target = RigidTransform(ground.frame, target, np.asarray(ground.T_base_target))
        found = found.seen_from(T_base_target)
    else:
        base = base if rig is not None else _frame_of_base(document, base, named)
        found = _in_base(found, base, rig, (document.target, _frame_ids(document).get(document.target, "")))
    for frame in found.members:
        if not frame or not frame.isprintable() or frame != frame.strip():
            raise UsageError(f"The frame '{frame}' has no name that files can hold; rename the LiDAR with --topic.")
    return found, named


def _frames_by_id(document: ResultDocument, lidars: Mapping[str, object]) -> dict[str, str]:
    ids = _frame_ids(document)
    found = {name: ids.get(name, "") for name in lidars}
    without = sorted(name for name, frame in found.items() if not frame)
    if without:
        raise InputError(f"The run knows no frame id of '{without[0]}'; export it with --frames names.")
    frame, count = Counter(found.values()).most_common(1)[0]
    if count > 1:
        raise InputError(f"{count} LiDARs of the run have the frame id '{frame}'; export it with --frames names.")
    return found


def _frame_ids(document: ResultDocument) -> dict[str, str]:
    """Return the frame id of each LiDAR as ROS 2 writes it; empty where it is not known."""
    return {name: entry.frame_id.removeprefix("/") for name, entry in document.input.lidars.items()}


def _frame_of_base(document: ResultDocument, base: str | None, named: Mapping[str, str]) -> str | None:
    """Return the frame of the LiDAR whose name or frame id is given; another name, which a base may have, as it is.

    Args:
        named: the frame of each LiDAR that has a pose.
    """
    ids = _frame_ids(document)
    if base is None or base == ids.get(document.target):
        return base
    lidars = [base] if base in document.lidars else [name for name in document.lidars if ids.get(name) == base]
    if not lidars:
        return base
    if len(lidars) > 1:
        raise InputError(f"{len(lidars)} LiDARs of the run have the frame id '{base}'; give a LiDAR's name as --base.")
    if lidars[0] not in named:
        status = document.lidars[lidars[0]].status.replace("_", " ")
        further = ", or --with-uncertain" if status == "uncertain" else ""
        raise InputError(f"{lidars[0]} is {status} and cannot be the common frame; give another --base{further}.")
    return named[lidars[0]]


def _in_base(found: Extrinsics, base: str | None, rig: Path | None, names: tuple[str, str]) -> Extrinsics:
    """Return the same poses in another frame, where the target gets a pose of its own; `rig` has one of its names."""
    if rig is not None:
        known = read_extrinsics(rig)
        base, target = base or known.target, next((name for name in names if name in known.members), names[0])
        for frame in (target, base):
            if frame not in known.members:
                raise UnknownNameError("frame", frame, known.members, str(rig))
        pose = known.between(base, target)
        require_metres(pose, str(rig))
        T_base_target = RigidTransform(pose.target, found.target, pose.matrix)
    elif base in (None, found.target):
        return found
    elif base in found.members:
        T_base_target = found.between(str(base), found.target)
    else:
        T_base_target = RigidTransform.identity(str(base), found.target)
    base = T_base_target.target
    is_own = base == found.target and np.array_equal(T_base_target.matrix, np.eye(4))
    if base in found.members and rig is not None and not is_own:
        raise UsageError(f"The base frame '{base}' has the name of a LiDAR of the run; give another one.")
    return found.seen_from(T_base_target)


def _own_base(document: ResultDocument, base: str | None, *, with_uncertain: bool) -> GroundEntry | None:
    """Return the base frame on the ground that the run found, if that is what is asked for."""
    ground = document.ground
    if ground is None or (ground.T_base_target_rig is None if base is None else base != ground.frame):
        return None
    if ground.frame in document.lidars:
        raise UsageError(
            f"The base frame '{ground.frame}' of the run has the name of a LiDAR; calibrate again with another --base."
        )
    if ground.doubt and not with_uncertain:
        raise InputError(
            f"The base frame '{ground.frame}' of the run is uncertain: {ground.doubt}; give --with-uncertain, or "
            f"another frame as --base."
        )
    return ground
