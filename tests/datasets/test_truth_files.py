# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tomli_w

from multilica.datasets.scene import find_truth, read_truth
from multilica.errors import SourceNotFoundError, UnreadableSourceError
from multilica.extrinsics import extrinsics_table
from tests.datasets.dataset_writers import truth_yaml
from tests.runs.made_runs import made_truth

NAMES = {"front": "main_lidar", "left": "lidar_1", "rear": "lidar_2"}


@pytest.mark.parametrize("quaternions", [False, True])
def test_the_authors_file_is_read(quaternions: bool, tmp_path: Path) -> None:
    file = tmp_path / "config.yaml"
    file.write_text(truth_yaml(made_truth(), "front", NAMES, quaternions=quaternions))
    truth = read_truth(file)
    assert truth.members == {"truth", *NAMES.values()}
    for lidar, name in NAMES.items():
        found = truth.between("main_lidar", name)
        np.testing.assert_allclose(found.matrix, made_truth().between("front", lidar).matrix, atol=1e-9)


def test_a_table_of_simulate_is_read(tmp_path: Path) -> None:
    file = tmp_path / "truth.toml"
    file.write_text(tomli_w.dumps(extrinsics_table(made_truth())))
    found = read_truth(file).between("front", "left")
    np.testing.assert_allclose(found.matrix, made_truth().between("front", "left").matrix, atol=1e-12)


def test_the_nearest_truth_counts(tmp_path: Path) -> None:
    near, far = tmp_path / "scene", tmp_path
    near.mkdir()
    assert find_truth(near, far) is None
    (far / "truth.toml").touch()
    assert find_truth(near, far) == far / "truth.toml"
    (near / "config.yaml").touch()
    assert find_truth(near, far) == near / "config.yaml"
    (near / "truth.yaml").touch()
    assert find_truth(near, far) == near / "truth.yaml"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "has no poses below 'ground_truth:'"),
        ("calibration:\n  lidar_1: [0, 0, 0, 0, 0, 0]\n", "has no poses below 'ground_truth:'"),
        ("ground_truth:\n  lidar_1: [0, 0, 0]\n", "has 3 numbers for 'lidar_1'; expected 6"),
        ("ground_truth:\n  lidar_1: [0, 0, 0, one, 0, 0]\n", "has no pose of 'lidar_1' that can be read"),
        ("ground_truth:\n  lidar_1: [0, 0, 0, 0, 0, 0, 0]\n", "has no pose of 'lidar_1' that can be read"),
        ("ground_truth:\n  lidar_1: [nan, 0, 0, 0, 0, 0]\n", "has no pose of 'lidar_1' that can be read"),
    ],
)
def test_a_damaged_file_is_one_sentence(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text(text)
    with pytest.raises(UnreadableSourceError, match=words) as caught:
        read_truth(tmp_path / "config.yaml")
    assert str(caught.value).count("\n") == 0


def test_a_file_that_is_no_text(tmp_path: Path) -> None:
    (tmp_path / "truth.yaml").write_bytes(b"\xff\xfe")
    with pytest.raises(UnreadableSourceError, match="is not a text file"):
        read_truth(tmp_path / "truth.yaml")
    with pytest.raises(SourceNotFoundError, match="No truth at"):
        read_truth(tmp_path / "none.yaml")
