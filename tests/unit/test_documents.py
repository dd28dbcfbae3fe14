# SPDX-License-Identifier: Apache-2.0
"""Documents that no program of good will writes, for every reader of documents."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from contextlib import nullcontext
from io import BytesIO
from pathlib import Path

import pytest
from mcap.writer import Writer

import multilica
from multilica.config import CalibrationConfig, load_config, with_overrides
from multilica.documents import DocumentError, parse_json, parse_toml, parse_yaml, shown
from multilica.errors import MultilicaError, UnreadableSourceError, UsageError
from multilica.extrinsics import EXTRINSICS_SCHEMA, read_extrinsics_table
from multilica.ingest.transforms import read_urdf
from multilica.results.document import parse_result
from multilica.runs.run_documents import read_run, read_run_document
from tests.sinks.made_documents import made_document

DEEP = 100_000
NUMBERS = ["1e300", "-1e300", "inf", "-inf", "nan", "9" * 5000, "-" + "9" * 5000, "9" * 40, "1" + "0" * 30, "1e999"]
WRONG = ['"x"', "true", "[]", "{}", "[1, [2]]", "1979-05-27", '"\\ud800"', "[true, true, true]"]
NESTED = ["[" * DEEP, "[" * DEEP + "]" * DEEP, "{a=" * DEEP, '{"a":' * DEEP + "1" + "}" * DEEP, "[" * 70 + "]" * 70]
VALUES = [*NUMBERS, *WRONG, *NESTED, "0x" + "f" * 5000, "", "\x00", "\ufeff1", '"' + "y" * 100_000 + '"']


def _config(text: str, folder: Path) -> None:
    path = folder / "config.toml"
    path.write_text(f"[preprocess]\nvoxel_size_m = {text}\n", encoding="utf-8", errors="replace")
    load_config(path)


def _setting(text: str, folder: Path) -> None:
    del folder
    with_overrides(CalibrationConfig(), [f"preprocess.voxel_size_m={text}"])


def _table(text: str, folder: Path) -> None:
    path = folder / "truth.toml"
    head = f'schema = "{EXTRINSICS_SCHEMA}"\ntarget = "base"\n[lidars.left]\nrpy_deg = [0, 0, 0]\n'
    path.write_text(f"{head}xyz_m = [0.0, 0.0, {text}]\n", encoding="utf-8", errors="replace")
    read_extrinsics_table(path)


def _matrix(text: str, folder: Path) -> None:
    path = folder / "prior.toml"
    head = f'schema = "{EXTRINSICS_SCHEMA}"\ntarget = "base"\n[lidars.left]\n'
    rows = f"[[1, 0, 0, {text}], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"
    path.write_text(f"{head}T_target_source = {rows}\n", encoding="utf-8", errors="replace")
    read_extrinsics_table(path)


def _urdf(text: str, folder: Path) -> None:
    path = folder / "robot.urdf"
    quoted = text.replace("&", "").replace("<", "").replace('"', "'")
    joint = f'<joint name="j" type="fixed"><parent link="a"/><child link="b"/><origin xyz="0 0 {quoted}"/></joint>'
    path.write_text(f"<robot>{joint}</robot>", encoding="utf-8", errors="replace")
    read_urdf(path)


def _exchanged(name: str, head: str, text: str, tail: str, folder: Path) -> None:
    path = folder / name
    path.write_text(f"{head}{text}{tail}", encoding="utf-8", errors="replace")
    multilica.read_extrinsics(path)


def _autoware(text: str, folder: Path) -> None:
    _exchanged("a.yaml", "a: {b: {x: 0, y: 0, z: ", text, ", roll: 0, pitch: 0, yaw: 0}}", folder)


def _kalibr(text: str, folder: Path) -> None:
    head = "lidar0: {frame: b, T_base_lidar: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, "
    _exchanged("a.yaml", head, text, "], [0, 0, 0, 1]]}", folder)


def _opencalib(text: str, folder: Path) -> None:
    head = '{"a-to-b-extrinsic": {"param": {"sensor_calib": {"data": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, '
    _exchanged("a.json", head, text, "], [0, 0, 0, 1]]}}}}", folder)


def _csv(text: str, folder: Path) -> None:
    _exchanged("a.csv", "target,source,x_m,y_m,z_m,qx,qy,qz,qw\na,b,0,0,", text, ",0,0,0,1", folder)


def _kitti(text: str, folder: Path) -> None:
    _exchanged("a.txt", "Tr_a_to_b: 1 0 0 0 0 1 0 0 0 0 1 ", text, "", folder)


def _command(text: str, folder: Path) -> None:
    _exchanged("a.sh", "static_transform_publisher --z ", text, " --frame-id a --child-frame-id b", folder)


def _launch(text: str, folder: Path) -> None:
    head = "Node(package='tf2_ros', executable='static_transform_publisher', arguments=[0, 0, "
    _exchanged("a.py", head, text, ", 0, 0, 0, 'a', 'b'])", folder)


def _result(text: str, folder: Path) -> None:
    path = folder / "result.json"
    path.write_text(f'{{"schema": {text}, "lidars": {text}}}', encoding="utf-8", errors="replace")
    for read in (read_run, read_run_document):
        with pytest.raises(MultilicaError):
            read(path)
    read_run_document(folder)


def _timing(text: str, folder: Path) -> None:
    parse_result(folder / "result.json", f'{{"schema": "multilica/result/1", "timing_s": {{"fine": {text}}}}}')


def _attached(text: str, folder: Path) -> None:
    path = folder / "result.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_attachment(0, 0, "result.json", "application/json", text.encode("utf-8", "replace"))
        writer.finish()
    read_run_document(path)


READERS: list[Callable[[str, Path], None]] = [
    _config, _setting, _table, _matrix, _urdf, _result, _timing, _attached,
    _autoware, _kalibr, _opencalib, _csv, _kitti, _command, _launch
]  # fmt: skip


@pytest.mark.parametrize("value", VALUES, ids=lambda value: repr(value[:12]))
@pytest.mark.parametrize("read", READERS, ids=lambda read: read.__name__)
def test_each_document_is_refused_in_one_sentence(
    tmp_path: Path, read: Callable[[str, Path], None], value: str
) -> None:
    with pytest.raises(MultilicaError) as caught:
        read(value, tmp_path)
    text = str(caught.value)
    assert len(text) <= 500
    assert text.isprintable()
    assert text.endswith((".", "?"))


@pytest.mark.parametrize(
    ("read", "field"),
    [(_config, "preprocess.voxel_size_m"), (_setting, "voxel_size_m"), (_table, "lidars.left.xyz_m"), (_urdf, "xyz"),
     (_matrix, "lidars.left.T_target_source"), (_timing, "timing_s.fine")],
)  # fmt: skip
def test_a_length_beyond_all_measure_names_its_field(
    tmp_path: Path, read: Callable[[str, Path], None], field: str
) -> None:
    for value in ("1e300", "1e9") if read is not _timing else ("1e300",):
        with pytest.raises(MultilicaError, match=field.replace(".", r"\.")) as caught:
            read(value, tmp_path)
        assert "1e+" in str(caught.value) or value in str(caught.value)


def test_keys_of_thousands_of_parts_are_refused() -> None:
    key = ".".join("a" * 100_000)
    with pytest.raises(DocumentError, match="nested more than 64 levels"):
        parse_toml(f"{key} = 1")
    with pytest.raises(UsageError, match="Cannot read the setting"):
        with_overrides(CalibrationConfig(), [f"{key}=1"])


def test_a_document_that_is_a_pointer_of_git_lfs(tmp_path: Path) -> None:
    pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n"
    for name, read in (
        ("a.toml", load_config),
        ("b.toml", read_extrinsics_table),
        ("c.json", read_run_document),
        ("d.urdf", read_urdf),
    ):
        (tmp_path / name).write_text(pointer)
        with pytest.raises(MultilicaError, match="`git lfs pull`"):
            read(tmp_path / name)


def test_documents_are_bounded(tmp_path: Path) -> None:
    path = tmp_path / "config.toml"
    path.write_bytes(b"#" * ((1 << 20) + 1))
    with pytest.raises(MultilicaError, match="it has more than 1048576 bytes"):
        load_config(path)
    with pytest.raises(MultilicaError, match="it has more than 1048576 bytes"):
        load_config(Path("/dev/zero"))
    with pytest.raises(DocumentError, match="millions of values"):
        parse_json(b"[" + b"[]," * 2_000_000 + b"[]]")
    with pytest.raises(DocumentError, match="a number of thousands of digits"):
        parse_json("9" * 5000)


def test_depth_is_limited_whoever_reads_next() -> None:
    for depth, is_read in ((64, True), (65, False), (900, False)):
        for text in ("[" * depth + "]" * depth, '{"a":' * (depth - 1) + "[]" + "}" * (depth - 1)):
            with nullcontext() if is_read else pytest.raises(DocumentError, match="nested more than 64 levels deep"):
                parse_json(text)
    with pytest.raises(DocumentError, match="nested more than 64 levels deep"):
        parse_toml("a = " + "[" * 65 + "]" * 65)


@pytest.mark.parametrize(
    ("text", "clause"),
    [
        ("a: &x 1\nb: *x", "it has an alias"),
        ("a: !!python/name:os.system", "it has the tag '.*python/name:os.system'"),
        ("a: 1\na: 2", "duplicate key"),
        ("[" * 65 + "]" * 65, "nested more than 64 levels deep"),
        ("[1, " * 65 + "1]" * 65, "nested more than 64 levels deep"),
        ("".join(f"{' ' * level}a:\n" for level in range(70)), "nested more than 64 levels deep"),
        ("a: [1", "in line 1"),
        ("a: .inf", "a is inf"),
        ("a: " + "9" * 5000, "a number of thousands of digits"),
        ("? {a: 1}\n: 2", "unhashable"),
        ("a: 2024-13-45", "month must be"),
        ("#" * ((256 << 10) + 1), "it has more than 262144 bytes"),
        (b"\xff\xfe", "can't decode"),
        ("a: 1\n---\nb: 2", "expected a single document in the stream, but found another document in line 2"),
    ],
)
def test_yaml_that_is_refused(text: str | bytes, clause: str) -> None:
    with pytest.raises(DocumentError, match=clause):
        parse_yaml(text)


def test_what_is_allowed_is_read() -> None:
    value = {"a": [1, -2.5, True, None, "x", 2**62], "b": {"c": [[[]]]}}
    assert parse_json(json.dumps(value)) == value
    assert parse_yaml(json.dumps(value)) == value
    assert parse_yaml("[" * 64 + "]" * 64) == parse_json("[" * 64 + "]" * 64)
    assert parse_yaml("a: [1, 1.5e-7]\nb: yes") == {"a": [1, 1.5e-7], "b": "yes"}
    assert parse_toml("a.b = [1, 1.5]\nc = true") == {"a": {"b": [1, 1.5]}, "c": True}


def test_a_damaged_attachment_is_refused(tmp_path: Path) -> None:
    buffer = BytesIO()
    writer = Writer(buffer)
    writer.start()
    writer.add_attachment(0, 0, "result.json", "application/json", b"{}")
    writer.finish()
    content = buffer.getvalue()
    start = content.index(b"\x09")
    path = tmp_path / "result.mcap"
    for length in (0, 5, 1 << 40, (1 << 64) - 1):
        path.write_bytes(content[: start + 1] + struct.pack("<Q", length) + content[start + 9 :])
        with pytest.raises(MultilicaError, match=r"result\.mcap"):
            read_run_document(path)


@pytest.mark.parametrize("axis", range(3))
def test_a_pose_metres_without_end_away_is_no_result(axis):
    values = made_document()
    values["lidars"]["rear"]["T_target_source"][axis][3] = 1e12
    with pytest.raises(UnreadableSourceError, match="is not a whole result: lidars"):
        parse_result("result.json", json.dumps(values))


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("x" * 60, f"'{'x' * 60}'"),
        ("x" * 100, f"'{'x' * 60}...'"),
        ("\n" * 61, "'" + r"\n" * 29 + "\\..."),
        ([1] * 40, repr([1] * 40)),
        ([1] * 50, f"{repr([1] * 50)[:60]}..."),
        (2**63, repr(2**63)),
        (-(2**64), "an integer of more than 18 digits"),
        (True, "True"),
    ],
)
def test_a_value_is_shown_in_a_few_characters(value, expected):
    assert shown(value) == expected


def test_a_target_that_is_no_lidar_is_no_result():
    with pytest.raises(UnreadableSourceError, match="`lidars` lacks the target 'roof'"):
        parse_result("result.json", json.dumps(made_document() | {"target": "roof"}))
