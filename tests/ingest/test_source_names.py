# SPDX-License-Identifier: Apache-2.0
"""Results name their sources without the folders of the machine."""

from __future__ import annotations

from pathlib import Path

import pytest

from multilica import read_snapshot
from multilica.ingest.locate import listed_names, locate, names_of, without_folders
from tests.ingest.support.recording_writers import make_snapshot, write_mcap


@pytest.mark.parametrize(
    ("given", "names"),
    [
        (["/data/logs/drive.mcap"], ["drive.mcap"]),
        (["logs/drive.mcap"], ["drive.mcap"]),
        (["/data/bag/"], ["bag"]),
        (["/data/a.mcap", "/data/b.mcap"], ["a.mcap", "b.mcap"]),
        (["/data/logs/1/drive.mcap", "/data/logs/2/drive.mcap"], ["1/drive.mcap", "2/drive.mcap"]),
        (["/data/left/1/a.pcd", "/data/right/a.pcd"], ["left/1/a.pcd", "right/a.pcd"]),
        (["s3://bucket/june/drive.mcap"], ["s3://bucket/june/drive.mcap"]),
        (["https://me:secret@host/a.mcap?key=1", "/data/a.mcap"], ["https://host/a.mcap", "a.mcap"]),
        ([], []),
    ],
)
def test_a_source_has_the_name_of_its_file(given: list[str], names: list[str]) -> None:
    assert list(names_of([locate(each) for each in given])) == names


def test_a_folder_is_named_though_it_is_given_by_a_dot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_mcap(make_snapshot(), tmp_path / "drive.mcap")
    monkeypatch.chdir(tmp_path)
    assert names_of([Path()]) == (tmp_path.name,)
    assert read_snapshot(".").source == tmp_path.name
    assert without_folders(["a. b."], [Path()]) == ("a. b.",)


def test_many_sources_are_not_all_listed() -> None:
    assert (
        listed_names([Path(f"/data/{number}.pcd") for number in range(7)]) == "0.pcd, 1.pcd, 2.pcd, 3.pcd, 4.pcd, ..."
    )


def test_texts_lose_the_folders() -> None:
    paths = [Path("/data/run"), Path("/data/run.mcap"), Path("x/a.mcap")]
    texts = without_folders(["In /data/run.mcap, beside /data/run: x/a.mcap", "none"], paths)
    assert texts == ("In run.mcap, beside run: a.mcap", "none")
