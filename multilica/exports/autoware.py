# SPDX-License-Identifier: Apache-2.0
"""Autoware's `sensors_calibration.yaml` and `sensor_kit_calibration.yaml`: parent, child, x to yaw in m and rad."""

from io import BytesIO
from pathlib import Path
from typing import Any

from multilica.errors import UnreadableSourceError
from multilica.exports.values import (
    extrinsics_of_tree,
    mapping_of,
    numbers,
    pose_of_rpy,
    quoted,
    read_text,
    read_yaml,
)
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.sinks.text.extrinsics_text import child_poses, number_text

_KEYS = ("x", "y", "z", "roll", "pitch", "yaw")


def autoware_yaml(extrinsics: Extrinsics) -> str:
    """Return the poses below the common frame."""
    return f"{quoted(extrinsics.target)}:\n" + "".join(
        f"  {quoted(pose.source)}:\n"
        + "".join(f"    {key}: {number_text(value)}\n" for key, value in _values(pose).items())
        for pose in child_poses(extrinsics)
    )


def read_autoware(path: Path) -> list[RigidTransform]:
    """Read the pose of each child in its parent."""
    poses = []
    for parent, children in read_yaml(path).items():
        for child, values in mapping_of(children, f"'{parent}'").items():
            given = mapping_of(values, f"'{child}'")
            if set(given) != set(_KEYS):
                raise ValueError(f"'{child}' has {', '.join(given) or 'nothing'}; expected {', '.join(_KEYS)}")
            found = numbers([given[key] for key in _KEYS], f"'{child}'")
            poses.append(pose_of_rpy(parent, child, found[:3], found[3:]))
    return poses


def updated_autoware(path: Path, extrinsics: Extrinsics) -> bytes:
    """Return the file with new or further poses below the common frame; other entries and comments stay.

    Raises:
        UnreadableSourceError: it is not such a file, or the frames would be no tree.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.representer import RoundTripRepresenter

    yaml = YAML(pure=True)
    yaml.Representer = type("Representer", (RoundTripRepresenter,), {})
    yaml.Representer.add_representer(float, _represent_number)
    yaml.preserve_quotes = True
    yaml.width = 4096  # long lines stay as they are
    content = BytesIO()
    try:
        known = read_autoware(path)
        new = child_poses(extrinsics)
        frames = {(pose.target, pose.source) for pose in new}
        extrinsics_of_tree([*(pose for pose in known if (pose.target, pose.source) not in frames), *new])
        document = yaml.load(read_text(path))
        below = document.setdefault(extrinsics.target, {})
        for pose in new:
            below.setdefault(pose.source, {}).update(_values(pose))
        yaml.dump(document, content)
    except ValueError as error:
        raise UnreadableSourceError(f"{path} cannot take the poses: {error}.") from error
    return content.getvalue()


def _represent_number(representer: Any, value: float) -> Any:  # noqa: ANN401 - of ruamel.yaml
    return representer.represent_scalar("tag:yaml.org,2002:float", number_text(value))


def _values(pose: RigidTransform) -> dict[str, float]:
    return dict(zip(_KEYS, (*pose.xyz_m.tolist(), *pose.rpy_rad.tolist()), strict=True))
