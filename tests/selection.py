# SPDX-License-Identifier: Apache-2.0
"""Plugin of pytest that chooses the tests of a push; `make nightly` sets MULTILICA_NIGHTLY and runs all.

`@pytest.mark.nightly` is for more cases of tests that each push runs. `@pytest.mark.in_turn` is for expensive ones
beside them: a push runs a twelfth, others than the push before. `@pytest.mark.shows(*paths)` is for tests of pictures
and pages, which run if one of these paths changed since the commit MULTILICA_BASE. Without it they run too.
"""

from __future__ import annotations

import os
import subprocess
import zlib
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from typing import TypeVar

import pytest

Case = TypeVar("Case")

ROOT = Path(__file__).parents[1]
TURNS = 12
NIGHTLY = os.environ.get("MULTILICA_NIGHTLY", "") not in ("", "0")
# A change of these could change the outcome of any test.
COMMON = (
    ".ci",
    "Makefile",
    "constraints.txt",
    "pyproject.toml",
    "tests/conftest.py",
    "tests/node",
    "tests/selection.py",
)
# Files of many seconds, the longest first: one that starts late keeps one worker busy when the other is done.
LONGEST = (
    "tests/fleet/test_real_log_tasks.py",
    "tests/documentation/test_commands.py",
    "tests/multi_snapshot/test_drive.py",
    "tests/pipeline/test_pair_search.py",
    "tests/ros2/test_watch.py",
    "tests/ros2/test_sources.py",
    "tests/packaging/test_wheel.py",
    "tests/pipeline/test_driving.py",
    "tests/unit/simulate/test_simulate.py",
    "tests/sinks/rerun/test_headless_viewer.py",
    "tests/unit/simulate/test_disturbances.py",
    "tests/sinks/rerun/test_data.py",
    "tests/pipeline/test_paper.py",
    "tests/checks/test_pipelines.py",
    "tests/sinks/mcap/test_foxglove_studio.py",
    "tests/documentation/test_site.py",
)
# Sources of the files of a run, for `shows`.
RUN_FILES = (
    *(f"multilica/{name}" for name in ("config", "diagnosis", "events.py", "geometry.py", "results", "sinks")),
    "tests/sinks",
)


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "nightly: one of the further cases that `make nightly` adds")
    config.addinivalue_line("markers", f"in_turn: one of {TURNS} pushes runs it, and `make nightly`")
    config.addinivalue_line(
        "markers", "shows(*paths): runs if one of the paths changed since MULTILICA_BASE, or at night"
    )


def pytest_report_header() -> str:
    return f"MULTILICA_SEED={push_seed()} MULTILICA_BASE={os.environ.get('MULTILICA_BASE', '')}"


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print what repeats a failure where `-q` leaves out the header."""
    if terminalreporter.verbosity < 0 and terminalreporter.stats.get("failed"):
        terminalreporter.write_line(pytest_report_header())


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what this run leaves out, and start with the files that take longest."""
    changed = changed_paths(os.environ.get("MULTILICA_BASE", ""))
    for item in items:
        for mark in item.iter_markers("shows"):
            if missing := [path for path in mark.args if not (ROOT / path).exists()]:
                raise pytest.UsageError(f"{item.nodeid} shows {', '.join(missing)}, which is not there")
            if not (NIGHTLY or shows_a_change(changed, mark.args)):
                item.add_marker(pytest.mark.skip(reason="nothing that it shows has changed"))
        if not NIGHTLY and item.get_closest_marker("nightly"):
            item.add_marker(pytest.mark.skip(reason="make nightly runs it"))
        edited = item.path.is_relative_to(ROOT) and str(item.path.relative_to(ROOT)) in (changed or ())
        if item.get_closest_marker("in_turn") and not (NIGHTLY or edited or has_its_turn(item.nodeid)):
            item.add_marker(pytest.mark.skip(reason="another push runs it, and make nightly"))
    places = {ROOT / path: place for place, path in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path, len(LONGEST)))


def shows_a_change(changed: tuple[str, ...] | None, paths: Iterable[str]) -> bool:
    """Whether a path changed, or all could have: None stands for changes that are not known."""
    if changed is None:
        return True
    return any(Path(each).is_relative_to(path) for each in changed for path in (*paths, *COMMON))


def has_its_turn(test: str) -> bool:
    """Whether this push runs a test that has its turn; no matter which others were collected."""
    return (zlib.crc32(test.encode()) + push_seed()) % TURNS == 0


@cache
def changed_paths(base: str) -> tuple[str, ...] | None:
    """Return the files that differ from a commit, or None if there is none to compare with."""
    tracked = _git("diff", "--name-only", "--no-renames", base, "--") if base else None
    others = _git("ls-files", "--others", "--exclude-standard")
    return None if tracked is None or others is None else (*tracked, *others)


@cache
def push_seed() -> int:
    """Return the seed of random cases, another for each commit; MULTILICA_SEED repeats those of a push."""
    given = os.environ.get("MULTILICA_SEED")
    commit = _git("rev-parse", "HEAD")
    return int(given) if given else int(commit[0][:7], 16) if commit else 0


def seeds(count: int, *, at_night: int) -> range:
    """Return seeds that differ from push to push, or the larger set of each night, which stays the same."""
    return range(at_night) if NIGHTLY else range(push_seed(), push_seed() + count)


def some_of(cases: Iterable[Case], count: int, path_of: Callable[[Case], str] | None = None) -> list[Case]:
    """Return some cases of a set in which each is known to hold, others from push to push, and all at night.

    Cases whose path changed since MULTILICA_BASE are always among them.
    """
    known = list(cases)
    if NIGHTLY:
        return known
    chosen = {(push_seed() + index * len(known) // count) % len(known) for index in range(count)}
    changed = changed_paths(os.environ.get("MULTILICA_BASE", "")) if path_of else None
    return [
        case
        for place, case in enumerate(known)
        if place in chosen or (path_of is not None and path_of(case) in (changed or ()))
    ]


def _git(*arguments: str) -> list[str] | None:
    try:
        done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return None
    return done.stdout.splitlines() if done.returncode == 0 else None
