# SPDX-License-Identifier: Apache-2.0
"""Names that begin with ~, as of a folder that was set aside."""

import pytest

from multilica.fleet.tasks import run_task
from tests.fleet.support.listed import sources, write_files
from tests.fleet.support.requests import request


def test_a_name_that_begins_with_a_tilde_is_a_name(tmp_path, monkeypatch):
    write_files(tmp_path, "~old/a.mcap", "~/b.mcap")
    monkeypatch.setenv("HOME", str(tmp_path / "~"))
    monkeypatch.chdir(tmp_path)
    assert sources("./~old") == sources("~old") == sources("./~old/*") == ["~old/a.mcap"]
    assert sources("~") == sources("./~") == ["~/b.mcap"]
    monkeypatch.chdir("~old")
    assert sources(".") == sources("a.mcap") == ["~old/a.mcap"]


@pytest.mark.parametrize("source", ["~old/a.mcap", "~root/~1/a.mcap", "~a.mcap", "bus1/~a.mcap"])
def test_a_log_in_such_a_folder_is_read_there(tmp_path, monkeypatch, source):
    write_files(tmp_path, source)
    monkeypatch.chdir(tmp_path)
    row = run_task._answer(request(tmp_path, source))
    assert (row.state, row.reason) == ("failed", "unreadable")
    assert row.reason_text.startswith(f"{source} is not an MCAP file")
    assert str(tmp_path) not in row.reason_text
