# SPDX-License-Identifier: Apache-2.0
"""A push leaves out only what cannot have changed, and repeats its random cases on request."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests import selection

ROOT = Path(__file__).parents[3]
TESTS = """
import pytest
from tests.selection import seeds

@pytest.mark.shows("docs")
def test_shows(): pass

@pytest.mark.nightly
def test_nightly(): pass

@pytest.mark.in_turn
@pytest.mark.parametrize("turn", range(30))
def test_in_turn(turn): pass

@pytest.mark.parametrize("seed", seeds(2, at_night=4))
def test_seed(seed): assert seed >= 0
"""


@pytest.fixture(autouse=True)
def _nothing_is_kept():
    selection.changed_paths.cache_clear()
    selection.push_seed.cache_clear()


@pytest.mark.parametrize(
    ("changed", "runs"),
    [
        (None, True),
        ((), False),
        (("docs/index.md",), True),
        (("docs2/index.md", "multilica/docs"), False),
        (("pyproject.toml",), True),
    ],
)
def test_what_shows_a_change_runs(changed, runs):
    assert selection.shows_a_change(changed, ["docs"]) is runs


def test_changes_that_are_not_known_are_told_from_none(monkeypatch):
    assert selection.changed_paths("") is None
    assert selection.changed_paths("no-such-commit") is None
    monkeypatch.setattr(selection, "ROOT", Path("/"))
    assert selection.changed_paths("HEAD") is None


def test_changed_new_and_moved_files_are_found(tmp_path, monkeypatch):
    monkeypatch.setattr(selection, "ROOT", tmp_path)
    git = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b"]
    for name in ("kept", "changed", "moved"):
        (tmp_path / name).write_text(name, encoding="utf-8")
    for command in (["init", "-q"], ["add", "."], ["commit", "-qm", "first"], ["mv", "moved", "elsewhere"]):
        subprocess.run([*git, *command], check=True)
    (tmp_path / "changed").write_text("other", encoding="utf-8")
    (tmp_path / "new").write_text("new", encoding="utf-8")
    assert sorted(selection.changed_paths("HEAD")) == ["changed", "elsewhere", "moved", "new"]


def test_the_seed_of_a_push_can_be_repeated(monkeypatch):
    monkeypatch.delenv("MULTILICA_SEED", raising=False)
    monkeypatch.setattr(selection, "NIGHTLY", False)
    assert len(selection.seeds(3, at_night=9)) == 3
    selection.push_seed.cache_clear()
    monkeypatch.setenv("MULTILICA_SEED", "12")
    assert selection.seeds(3, at_night=9) == range(12, 15)
    assert selection.some_of("abcde", 4) == ["a", "c", "d", "e"]
    monkeypatch.setattr(selection, "NIGHTLY", True)
    assert selection.seeds(3, at_night=9) == range(9)
    assert selection.some_of("abcde", 4) == [*"abcde"]


def test_each_test_has_its_turn(monkeypatch):
    names = [f"tests/test_made.py::test_made[{number}]" for number in range(300)]
    turns = []
    for seed in range(selection.TURNS):
        monkeypatch.setattr(selection, "push_seed", lambda seed=seed: seed)
        turns.append({name for name in names if selection.has_its_turn(name)})
    assert sorted(name for turn in turns for name in turn) == sorted(names)
    assert min(map(len, turns)) > 15


def test_cases_whose_path_changed_are_chosen(monkeypatch):
    monkeypatch.setattr(selection, "NIGHTLY", False)
    monkeypatch.setattr(selection, "push_seed", lambda: 1)
    for changed, chosen in ((("d",), ["b", "d"]), ((), ["b"]), (None, ["b"])):
        monkeypatch.setattr(selection, "changed_paths", lambda _, changed=changed: changed)
        assert selection.some_of("abcd", 1, str) == chosen


def test_the_longest_files_exist():
    assert [path for path in selection.LONGEST if not (ROOT / path).is_file()] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("variables", "passed", "seed"), [({"MULTILICA_SEED": "7"}, 8, "[8]"), ({"MULTILICA_NIGHTLY": "1"}, 36, "[3]")]
)
def test_a_night_runs_all(tmp_path, variables, passed, seed):
    (tmp_path / "test_made.py").write_text(TESTS, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-v", "-p", "no:dash", "-p", "no:cacheprovider", "-p", "tests.selection"]
    command += ["-c", "/dev/null", "--rootdir", str(tmp_path), str(tmp_path)]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("MULTILICA_")} | variables
    output = subprocess.run(command, cwd=ROOT, env=environment, check=False, stdout=subprocess.PIPE, text=True).stdout
    assert f"{passed} passed" in output
    assert f"test_seed{seed} PASSED" in output
