# SPDX-License-Identifier: Apache-2.0
"""The formats of extrinsics; the functions that write and read them are imported when they are used."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from multilica.errors import UnknownNameError, UsageError

if TYPE_CHECKING:
    from multilica.extrinsics import Extrinsics
    from multilica.geometry import RigidTransform
    from multilica.ingest.transforms import Joint

    Writer = Callable[[Extrinsics], str | bytes]
    """A function that returns the content of a file."""
    Reader = Callable[[Path], Iterable[RigidTransform | Joint]]
    """A function that reads the edges of a tree of frames; raise ValueError, with a clause, for another file."""


@dataclass(frozen=True, slots=True)
class ExchangeFormat:
    """A format that a run is exported to.

    Args:
        writers: per suffix, ``module:function`` of this package, or of the library, that is a `Writer`.
        readers: per suffix, those of foreign files too, the same of a `Reader`.
    """

    name: str
    writers: Mapping[str, str]
    readers: Mapping[str, str]

    def content(self, extrinsics: Extrinsics, path: Path) -> bytes:
        """Return the content of a file."""
        write: Writer = _function(self.writers[self.suffix_of(path)])
        content = write(extrinsics)
        return content if isinstance(content, bytes) else content.encode()

    def read(self, path: Path) -> Extrinsics:
        """Read a file; one with a foreign suffix as if it had the first one of the format."""
        read: Reader = _function(self.readers.get(path.suffix, next(iter(self.readers.values()))))
        found: Extrinsics = _function("values:extrinsics_of_tree")(read(path))
        return found

    def suffix_of(self, path: Path) -> str:
        """Return the suffix of a file to write; raise UsageError if it is not one of the format."""
        if path.suffix not in self.writers:
            raise UsageError(
                f"Found --out {path} for the format {self.name}; expected a name that ends in "
                f"{' or '.join(self.writers)}."
            )
        return path.suffix


def _format(name: str, suffixes: str, writer: str, reader: str, *, also_read: str = "") -> ExchangeFormat:
    """Define a format whose files have one writer and one reader; suffixes are separated by spaces."""
    return ExchangeFormat(
        name, dict.fromkeys(suffixes.split(), writer), dict.fromkeys(f"{suffixes} {also_read}".split(), reader)
    )


_ALL = (
    _format("toml", ".toml", "text_files:toml_extrinsics", ""),  # `read_extrinsics` reads its own table
    _format(
        "urdf",
        ".urdf",
        "multilica.sinks.files.result_files:urdf_text",
        "multilica.ingest.transforms:read_urdf",
        also_read=".xacro .xml",
    ),
    ExchangeFormat(
        "ros2-launch",
        {".py": "ros_launch:launch_python", ".xml": "ros_launch:ros2_launch_xml", ".yaml": "ros_launch:launch_yaml"},
        {
            ".py": "ros_launch:read_launch_python",
            ".xml": "ros_launch:read_launch_xml",
            ".yaml": "ros_launch:read_launch_yaml",
            ".yml": "ros_launch:read_launch_yaml",
        },
    ),
    _format("ros2-static", ".sh .txt", "ros_launch:command_lines", "ros_launch:read_command_lines"),
    _format("ros1-launch", ".launch", "ros_launch:ros1_launch_xml", "ros_launch:read_launch_xml"),
    _format("tf-static", ".mcap", "ros_launch:tf_static_mcap", "ros_launch:read_tf_static", also_read=".bag .db3"),
    _format("autoware", ".yaml", "text_files:autoware_yaml", "text_files:read_autoware", also_read=".yml"),
    _format("kalibr", ".yaml", "text_files:kalibr_yaml", "text_files:read_kalibr", also_read=".yml"),
    _format("kitti", ".txt", "text_files:kitti_text", "text_files:read_kitti"),
    _format("matrices", ".txt", "multilica.sinks.files.result_files:matrix_text", "text_files:read_matrices"),
    _format("opencalib", ".json", "text_files:opencalib_json", "text_files:read_opencalib"),
    _format("csv", ".csv", "text_files:csv_text", "text_files:read_csv"),
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
    return getattr(import_module(module if "." in module else f"multilica.exports.{module}"), name)
