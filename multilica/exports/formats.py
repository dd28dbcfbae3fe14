# SPDX-License-Identifier: Apache-2.0
"""The formats of extrinsics."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any

from multilica.errors import UnknownNameError, UsageError
from multilica.extrinsics import Extrinsics

Writer = Callable[[Extrinsics], str | bytes]
Reader = Callable[[Path], Extrinsics]


@dataclass(frozen=True, slots=True)
class ExchangeFormat:
    """A format that a run is exported to.

    Args:
        suffixes: of its files.
        writers: per suffix, ``module:function``, relative to this package, that returns the content of a file.
        readers: the same for reading; empty for point clouds.
    """

    name: str
    title: str
    writers: Mapping[str, str]
    readers: Mapping[str, str]

    @property
    def suffixes(self) -> tuple[str, ...]:
        """Suffixes of its files."""
        return tuple(self.writers)

    def content(self, extrinsics: Extrinsics, path: Path) -> bytes:
        """Return the content of a file."""
        write: Writer = _function(self.writers[self.suffix_of(path)])
        content = write(extrinsics)
        return content if isinstance(content, bytes) else content.encode()

    def read(self, path: Path) -> Extrinsics:
        """Read a file; one with a foreign suffix as if it had the first one of the format."""
        read: Reader = _function(self.readers.get(path.suffix, next(iter(self.readers.values()))))
        return read(path)

    def suffix_of(self, path: Path) -> str:
        """Return the suffix of a file to write; raise UsageError if it is not one of the format."""
        if path.suffix not in self.suffixes:
            raise UsageError(
                f"Found --out {path} for the format {self.name}; expected a name that ends in "
                f"{' or '.join(self.suffixes)}."
            )
        return path.suffix


def _format(name: str, title: str, suffixes: str, writer: str, reader: str) -> ExchangeFormat:
    return ExchangeFormat(
        name,
        title,
        MappingProxyType(dict.fromkeys(suffixes.split(), writer)),
        MappingProxyType(dict.fromkeys(suffixes.split(), reader) if reader else {}),
    )


_LAUNCH = ExchangeFormat(
    "ros2-launch",
    "ROS 2 launch file",
    MappingProxyType(
        {
            ".py": "ros2_launch:launch_python",
            ".xml": "ros_launch_xml:ros2_launch_xml",
            ".yaml": "ros2_launch:launch_yaml",
        }
    ),
    MappingProxyType(
        {
            ".py": "ros2_launch:read_launch_python",
            ".xml": "ros_launch_xml:read_launch_xml",
            ".yaml": "ros2_launch:read_launch_yaml",
            ".yml": "ros2_launch:read_launch_yaml",
        }
    ),
)
_ALL = (
    _format("toml", "TOML table, as calibration.toml", ".toml", "toml_table:toml_extrinsics", "toml_table:read_toml"),
    _format("urdf", "URDF", ".urdf", ".sinks.text.extrinsics_text:urdf_text", "urdf:read_urdf_extrinsics"),
    _LAUNCH,
    _format(
        "ros2-static",
        "ROS 2 command lines",
        ".sh .txt",
        "ros2_launch:command_lines",
        "ros2_launch:read_command_lines",
    ),
    _format(
        "ros1-launch",
        "ROS 1 launch file",
        ".launch",
        "ros_launch_xml:ros1_launch_xml",
        "ros_launch_xml:read_launch_xml",
    ),
    _format("tf-static", "MCAP with /tf_static", ".mcap", "tf_static:tf_static_mcap", "tf_static:read_tf_static"),
    _format("autoware", "Autoware YAML", ".yaml", "autoware:autoware_yaml", "autoware:read_autoware"),
    _format("kalibr", "Kalibr-like YAML", ".yaml", "kalibr:kalibr_yaml", "kalibr:read_kalibr"),
    _format("kitti", "KITTI calibration file", ".txt", "matrices:kitti_text", "matrices:read_kitti"),
    _format("matrices", "4 x 4 matrices", ".txt", ".sinks.text.extrinsics_text:matrix_text", "matrices:read_matrices"),
    _format("opencalib", "OpenCalib JSON", ".json", "opencalib:opencalib_json", "opencalib:read_opencalib"),
    _format("csv", "CSV table", ".csv", "csv_table:csv_text", "csv_table:read_csv"),
)
FORMATS: Mapping[str, ExchangeFormat] = MappingProxyType({each.name: each for each in _ALL})
"""Formats of extrinsics by name."""
CLOUD_FORMATS = ("pcd", "ply", "las")
"""Formats of the stitched cloud, which are the suffixes of its files as well."""


def format_named(name: str) -> ExchangeFormat:
    """Return a format of extrinsics; raise UnknownNameError if there is none of that name."""
    if name not in FORMATS:
        raise UnknownNameError("format", name, FORMATS)
    return FORMATS[name]


def _function(place: str) -> Any:  # noqa: ANN401 - a function of a module that is loaded when it is used
    module, _, name = place.partition(":")
    return getattr(import_module(f".{module}", __package__), name)
