# SPDX-License-Identifier: Apache-2.0
"""Reading of extrinsics from any format."""

from pathlib import Path

from multilica.documents import DocumentError
from multilica.errors import MultilicaError, SourceNotFoundError, UnreadableSourceError
from multilica.exports.formats import FORMATS, ExchangeFormat, format_named
from multilica.exports.ros_launch import EXECUTABLE
from multilica.exports.text_files import KALIBR_MATRIX, KITTI_LINE
from multilica.exports.values import read_text, read_yaml
from multilica.extrinsics import Extrinsics, read_extrinsics_table
from multilica.ingest.transforms import parse_xml


def read_extrinsics(
    path: str | Path,
    format: str | None = None,  # noqa: A002 - the word of the command line
    *,
    with_uncertain: bool = False,
) -> Extrinsics:
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
    path = Path(path).expanduser()
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
