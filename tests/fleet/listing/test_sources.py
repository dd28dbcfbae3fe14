# SPDX-License-Identifier: Apache-2.0
import pytest

from tests.fleet.support.listed import sources, write_files


@pytest.fixture
def folder(tmp_path):
    logs = ("bus1/logs/a.mcap", "bus1/logs/b.mcap", "bus2/logs/a.mcap", "bus2/logs/c.mcap")
    return write_files(tmp_path, *logs)


def test_folders_of_one_name_share_no_source(folder):
    wanted = ["bus1/logs/a.mcap", "logs/b.mcap", "bus2/logs/a.mcap", "logs/c.mcap"]
    assert sources(folder / "bus1/logs", folder / "bus2/logs") == wanted
    assert sources(folder / "bus2/logs", folder / "bus1/logs") == wanted[2:] + wanted[:2]
    assert sources(folder / "bus1/logs/*", folder / "bus2/logs/a.mcap") == wanted[:3]


def test_a_source_of_its_own_stays(folder):
    logs = folder / "bus1/logs"
    assert sources(logs) == ["logs/a.mcap", "logs/b.mcap"]
    assert sources(logs, logs, logs / "a.mcap") == ["logs/a.mcap", "logs/b.mcap"] * 2 + ["logs/a.mcap"]
    (folder / "link").symlink_to(logs)
    assert {*sources(logs, folder / "link")} == {"logs/a.mcap", "logs/b.mcap"}
    assert sources(logs / "b.mcap", folder / "bus2/logs/c.mcap") == ["logs/b.mcap", "logs/c.mcap"]


def test_a_longer_source_is_no_other_log_s(folder):
    write_files(folder, "other/bus1/logs/a.mcap")
    found = sources(folder / "bus1/logs", folder / "bus2/logs", folder / "other/bus1")
    assert found.pop() == "bus1/logs/a.mcap"
    assert found == [f"{folder.name}/bus1/logs/a.mcap", "logs/b.mcap", f"{folder.name}/bus2/logs/a.mcap", "logs/c.mcap"]
    # The same log below two folders is one.
    assert sources(folder / "bus1", folder / "bus1/logs", folder / "bus2/logs")[::2] == [
        "bus1/logs/a.mcap",
        "bus1/logs/a.mcap",
        "bus2/logs/a.mcap",
    ]


def test_rows_of_manifests_share_no_source(folder):
    manifest = folder / "all.csv"
    rows = ["source", *(f"{folder}/{bus}/logs/a.mcap" for bus in ("bus1", "bus2")), "bus1/../bus1/logs/b.mcap"]
    manifest.write_text("\n".join([*rows, "s3://bucket/logs/a.mcap"]) + "\n")
    assert sources(manifest) == ["bus1/logs/a.mcap", "bus2/logs/a.mcap", "logs/b.mcap", "s3://bucket/logs/a.mcap"]
    for bus in ("bus1", "bus2"):
        (folder / bus / "june.csv").write_text("source\nlogs/a.mcap\n")
    assert sources(folder / "bus1/june.csv") == ["logs/a.mcap"]
    assert sources(folder / "bus1/june.csv", folder / "bus2/june.csv") == ["bus1/logs/a.mcap", "bus2/logs/a.mcap"]
