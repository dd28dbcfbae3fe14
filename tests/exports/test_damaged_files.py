# SPDX-License-Identifier: Apache-2.0
"""Damaged files give extrinsics or a sentence; `python -m tests.bench fuzz` tries thousands more."""

from __future__ import annotations

import time
from contextlib import nullcontext, suppress
from pathlib import Path

import numpy as np
import pytest

import multilica
from multilica.errors import MultilicaError, UnreadableSourceError
from multilica.exports import FORMATS, export_extrinsics
from multilica.exports.ros_launch import split_arguments
from tests.exports.made_rigs import made_rig
from tests.exports.test_conventions import ROS1_NODE, joint
from tests.ingest.support.mutations import mutated
from tests.ingest.support.structured import structured

KINDS = sorted((name, suffix) for name, each in FORMATS.items() for suffix in each.writers)
MUTATIONS = 60


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS, ids="".join)
def test_damaged_files_are_read_or_refused(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], kind: tuple[str, str]
) -> None:
    name, suffix = kind
    path = export_extrinsics(made_rig(), tmp_path / f"rig{suffix}", name)
    content = path.read_bytes()
    sentences = []
    for seed in range(MUTATIONS):
        path.write_bytes((structured if seed % 2 else mutated)(content, np.random.default_rng(seed)))
        with suppress(MultilicaError):
            multilica.read_extrinsics(path)
            continue
        sentences.append(seed)
    assert sentences
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_hostile_files_are_refused_soon(tmp_path: Path) -> None:
    chain = "".join(joint(f"j{each}", f"a{each}", f"a{each + 1}", "revolute") for each in range(3000))
    hostile = {
        "a.txt": "Tr_" + "_to_" * 60_000,
        "a.launch": ROS1_NODE.format("tf2_ros", "0 " * 1_000_000),
        "a.urdf": f'<robot name="r">{chain}</robot>',
        "a.py": "-" * 200_000 + "1",
        "b.py": "x" + ".x" * 100_000,
        "a.sh": "static_transform_publisher " + "'" * 200_000,
        "a.yaml": "[" * 200_000,
        "b.yaml": "a: " * 60_000,
    }
    for name, text in hostile.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
        start_s = time.perf_counter()
        with pytest.raises(UnreadableSourceError):
            multilica.read_extrinsics(tmp_path / name)
        assert time.perf_counter() - start_s < 20.0, name


def test_files_are_as_long_as_documented(tmp_path: Path) -> None:
    path = export_extrinsics(made_rig(), tmp_path / "rig.yaml", "autoware")
    content = path.read_bytes()
    for size, refused in ((256 << 10, False), ((256 << 10) + 1, True)):
        path.write_bytes(content + b"#" * (size - len(content)))
        with pytest.raises(UnreadableSourceError) if refused else nullcontext():
            multilica.read_extrinsics(path)


def test_commands_are_as_long_as_documented() -> None:
    assert split_arguments("a" * 4096) == ["a" * 4096]
    with pytest.raises(ValueError, match="4096"):
        split_arguments("a" * 4097)
