# SPDX-License-Identifier: Apache-2.0
"""A test that takes long without the mark fails, whoever spends the time; one that waits does not."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[3]
TESTS = """
import subprocess, sys, threading, time
import pytest

BURN = "import time; end = time.process_time() + 0.2\\nwhile time.process_time() < end: pass"

@pytest.fixture(scope="module")
def shared():
    exec(BURN)

@pytest.fixture
def own():
    exec(BURN)

def test_itself(): exec(BURN)
def test_its_thread(): thread = threading.Thread(target=exec, args=(BURN,)); thread.start(); thread.join()
def test_its_process(): subprocess.run([sys.executable, "-c", BURN], check=True)
def test_its_fixture(own): pass
def test_first_of_several(shared): pass
def test_second_of_several(shared): pass
def test_that_waits(): time.sleep(0.3)
@pytest.mark.slow
def test_with_the_mark(): exec(BURN)
"""


def run(folder: Path, *options: str) -> str:
    path = folder / "test_made.py"
    path.write_text(TESTS, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-p", "no:dash", "-p", "no:cacheprovider", "-p", "tests.slow_tests"]
    command += ["-c", "/dev/null", "--rootdir", str(folder), *options, str(path)]
    return subprocess.run(command, cwd=ROOT, check=False, stdout=subprocess.PIPE, text=True).stdout


@pytest.mark.in_turn
def test_a_slow_test_without_the_mark_fails(tmp_path: Path) -> None:
    output = run(tmp_path, "--fail-slow=0.15", f"--cpu-times={tmp_path / 'times.txt'}")
    failed = re.findall(r"_ test_(\w+) _+\n(.*) takes", output)
    assert dict(failed) == {
        "itself": "the test",
        "its_thread": "the test",
        "its_process": "the test",
        "its_fixture": "the test",
        "first_of_several": "the fixture shared",
    }, output
    times = [line.split(maxsplit=1) for line in (tmp_path / "times.txt").read_text(encoding="utf-8").splitlines()]
    assert "test_made.py::test_first_of_several the fixture shared" in [
        name for spent, name in times if float(spent) > 0.15
    ]
    assert [float(spent) for spent, _ in times] == sorted((float(spent) for spent, _ in times), reverse=True)


@pytest.mark.in_turn
def test_slow_tests_pass_where_time_does_not_matter(tmp_path: Path) -> None:
    assert "8 passed" in run(tmp_path)
    assert "7 passed, 1 deselected" in run(tmp_path, "-m", "not slow")
