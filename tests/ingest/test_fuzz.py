# SPDX-License-Identifier: Apache-2.0
"""Files damaged by seed, others at each push, for every reader; `python -m tests.bench fuzz` tries thousands more."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from multilica.ingest.containers import unindexed
from tests.ingest.support.mutations import SEEDS, mutated, read_or_refuse, write_seed
from tests.selection import seeds

MUTATIONS = 100
SLOW = {"a.laz": 5, "b.laz": 5, "packed.db3.zstd": 50, "ouster.mcap": 25}
"""Readers that start a process or unpack a file to disk, and files that are large."""
ONCE_FAILED = [
    ("messages.db3", 42),  # a compressed message that cannot be unpacked
    ("a.laz", 23),  # sizes for which the engine ends its process
    ("b.laz", 21),
]


def mutations(name: str) -> range:
    count = SLOW.get(name, MUTATIONS)
    return seeds(count, at_night=10 * count)


@pytest.mark.parametrize("name", SEEDS)
def test_whole_files_are_read(tmp_path: Path, name: str) -> None:
    snapshot = read_or_refuse(write_seed(name, tmp_path), inspect=True)
    assert snapshot is not None
    assert all(lidar.points_count > 0 for lidar in snapshot.lidars)


@pytest.mark.slow
@pytest.mark.parametrize("name", SEEDS)
def test_damaged_files_give_points_or_a_sentence(tmp_path: Path, capfd: pytest.CaptureFixture[str], name: str) -> None:
    path = write_seed(name, tmp_path)
    content = path.read_bytes()
    read = 0
    for seed in mutations(name):
        path.write_bytes(mutated(content, np.random.default_rng(seed)))
        read += read_or_refuse(path, inspect=seed % 8 == 0) is not None
    assert read < len(mutations(name))
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize("kept_bytes", [0, 2500])
@pytest.mark.parametrize("name", ["zstd.mcap", "plain.mcap", "unindexed.mcap", "unchunked.mcap", "plain.bag"])
def test_damaged_files_too_large_to_be_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, kept_bytes: int
) -> None:
    monkeypatch.setattr(unindexed, "_MAX_KEPT_BYTES", kept_bytes)
    path = write_seed(name, tmp_path)
    content = path.read_bytes()
    read = 0
    for seed in mutations(name):
        path.write_bytes(mutated(content, np.random.default_rng(seed)))
        read += read_or_refuse(path) is not None
    assert 0 < read < len(mutations(name))


@pytest.mark.parametrize(("name", "seed"), ONCE_FAILED)
def test_what_once_failed(tmp_path: Path, capfd: pytest.CaptureFixture[str], name: str, seed: int) -> None:
    path = write_seed(name, tmp_path)
    path.write_bytes(mutated(path.read_bytes(), np.random.default_rng(seed)))
    read_or_refuse(path, inspect=True)
    assert capfd.readouterr() == ("", "")
