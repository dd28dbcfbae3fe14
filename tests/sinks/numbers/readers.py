# SPDX-License-Identifier: Apache-2.0
"""Readers of what a run shows, and the algebra of poses, without the project's own code."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, message_factory
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

UNITS = {"m": ("m", 1.0), "mm": ("m", 1e-3), "deg": ("deg", 1.0), "rad": ("deg", 180.0 / math.pi)}


def turn_of_rpy_deg(rpy_deg: Sequence[float]) -> np.ndarray:
    """The matrix of a roll, then a pitch, then a yaw about fixed axes."""
    (sr, cr), (sp, cp), (sy, cy) = ((math.sin(a), math.cos(a)) for a in map(math.radians, rpy_deg))
    roll = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    pitch = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    yaw = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return yaw @ pitch @ roll


def turn_of_quaternion(x: float, y: float, z: float, w: float) -> np.ndarray:
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def rpy_deg_of(matrix: np.ndarray) -> tuple[float, float, float]:
    angles = math.atan2(matrix[2, 1], matrix[2, 2]), -math.asin(matrix[2, 0]), math.atan2(matrix[1, 0], matrix[0, 0])
    return tuple(map(math.degrees, angles))


def pose_of(xyz: Sequence[float], turn: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, xyz
    return pose


def assert_pose(entry: Mapping[str, Any], matrix: np.ndarray, name: str = "T_target_source") -> None:
    """Each form in which a document gives the pose is that matrix."""
    turns = {"rpy_deg": turn_of_rpy_deg, "quaternion_xyzw": lambda xyzw: turn_of_quaternion(*xyzw)}
    forms = [turn(entry[form]) for form, turn in turns.items() if form in entry]
    assert forms
    for turn in forms:
        np.testing.assert_allclose(pose_of(entry["xyz_m"], turn), matrix, atol=1e-9)
    if name in entry:
        np.testing.assert_allclose(entry[name], matrix, atol=1e-12)


def assert_figures(cells: Mapping[str, str], expected: Mapping[str, float]) -> None:
    """The cells with numbers are those expected, to half of the last digit, whatever unit the heading has."""
    found = dict(_in_base_units(*cell) for cell in cells.items() if re.fullmatch(r"-?[\d.,]+", cell[1]))
    assert {*found} == {*expected}
    for heading, (value, half_digit) in found.items():
        assert abs(value - expected[heading]) <= 1.001 * half_digit, (heading, value, expected[heading])


def _in_base_units(heading: str, text: str) -> tuple[str, tuple[float, float]]:
    quantity, _, unit = heading.rpartition(" ")
    base, factor = UNITS.get(unit, ("", 1.0))
    half_digit = 0.5 * 10.0 ** -len(text.partition(".")[2])
    heading = f"{quantity} {base}" if base else heading
    return heading, (factor * float(text.replace(",", "")), factor * half_digit)


def mcap_messages(path: Path) -> dict[str, list[Any]]:
    """Messages by topic: protobuf by the schema that is in the file, or ROS 2."""
    found: dict[str, list[Any]] = {}
    ros2 = DecoderFactory()
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            if schema.encoding == "protobuf":
                files = descriptor_pb2.FileDescriptorSet.FromString(schema.data).file
                value = message_factory.GetMessages(files)[schema.name].FromString(message.data)
            elif schema.encoding == "ros2msg":
                value = ros2.decoder_for(channel.message_encoding, schema)(message.data)
            else:
                value = message.data
            found.setdefault(channel.topic, []).append(value)
    return found


def xyz_of(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


def pose_of_message(translation: Any, rotation: Any) -> np.ndarray:
    return pose_of(xyz_of(translation), turn_of_quaternion(rotation.x, rotation.y, rotation.z, rotation.w))


@dataclass
class Table:
    section: str
    caption: str = ""
    rows: list[list[str]] = field(default_factory=list)

    def named(self) -> dict[str, dict[str, str]]:
        """Cells by the first one of their row and the heading of their column."""
        header, *rows = self.rows
        return {cells[0]: dict(zip(header[1:], cells[1:], strict=True)) for cells in rows}


class Page(HTMLParser):
    """Tables and text of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tables: list[Table] = []
        self.words: list[str] = []
        self._section, self._open = "", []
        self.feed(text)
        self.text = " ".join(" ".join(self.words).split())

    def in_section(self, name: str) -> list[Table]:
        return [table for table in self.tables if table.section == name]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._open.append(tag)
        if tag == "h2":
            self._section = dict(attrs)["id"]
        if tag == "table":
            self.tables.append(Table(self._section))
        if tag == "tr":
            self.tables[-1].rows.append([])
        if tag in ("td", "th"):
            self.tables[-1].rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        while self._open and self._open.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        if {"script", "style"} & {*self._open}:
            return
        self.words.append(data)
        if "caption" in self._open:
            self.tables[-1].caption += data
        elif {"td", "th"} & {*self._open}:
            cells = self.tables[-1].rows[-1]
            cells[-1] = " ".join(f"{cells[-1]} {data}".split())


def markdown_tables(text: str) -> list[dict[str, dict[str, str]]]:
    """Cells by the first one of their row and the heading of their column."""
    tables = []
    for lines in re.findall(r"(?:^\|.*\n?)+", text, re.MULTILINE):
        rows = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines.splitlines()]
        header, _, *body = ([cell.strip("| ") for cell in row] for row in rows)
        tables.append({cells[0]: dict(zip(header[1:], cells[1:], strict=True)) for cells in body})
    return tables


def terminal_row(text: str, name: str) -> dict[str, str]:
    """Cells of a row of the first table by the heading of their column, which ends where the cell ends."""
    lines = text.splitlines()
    top = next(index for index, line in enumerate(lines) if line.split()[:1] == ["LiDAR"])
    row = next(line for line in lines[top:] if line.lstrip().startswith(name))
    ends = [found.end() for found in re.finditer(r"(?<=\s)(-?[\d.]+|-)(?=\s|$)", row)]
    starts = [ends[0] - 6, *ends[:-1]]
    headings = [
        " ".join(line[start:end].strip() for line in lines[top - 1 : top + 1]).strip()
        for start, end in zip(starts, ends, strict=True)
    ]
    return {heading: row[start:end].split()[-1] for heading, start, end in zip(headings, starts, ends, strict=True)}
