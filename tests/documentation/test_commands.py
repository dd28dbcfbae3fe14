# SPDX-License-Identifier: Apache-2.0
"""Every command that a page shows does what it should, or is listed here with the reason why no test can run it."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from multilica.simulate import simulate_snapshot
from tests.cli.support import ROOT, Invoke
from tests.documentation.vehicle import copy_files, lose_a_lidar, write_files
from tests.selection import NIGHTLY, TURNS, some_of

pytestmark = pytest.mark.slow

PAGES = (
    *ROOT.glob("*.md"),
    *ROOT.glob("docs/*.md"),
    *ROOT.glob("docs/decisions/*.md"),
    *ROOT.glob("docs/reference/*.md"),
)
NOT_RUN = {
    r"make ": "installs, or takes minutes; continuous integration runs `make test`",
    r"(sudo )?(apt-get|pip) ": "installs",
    r"aws ": "another program, which needs an account",
    r".*s3://": "needs a bucket; tests/ingest/remote and tests/fleet read and write one",
    r"multilica record ws://": "needs a vehicle; tests/ingest/live record from a server",
    r"multilica publish .*--ws": "serves until a signal; tests/ros2/test_publish.py reads from it",
    r"multilica \w+ .*ros2://|source /opt/ros": "needs ROS 2; tests/ros2 run it with nodes",
    r"multilica view [^-]*$": "opens a window",
    r"multilica datasets ": "needs a data set; tests/datasets and tests/cli/test_datasets.py run it on simulated ones",
    r"multilica export run/": "tests/exports/test_cookbook.py runs this section",
}
"""Start of a command, as a pattern -> why it is not run."""
ENDS = {
    "multilica calibrate symmetric-garage.mcap --out symmetric-garage": 4,
    "multilica diff before/ after/": 5,
}
"""Exit codes other than 0."""
ALONE = "multilica demo"
"""It reads and leaves nothing that a page has, so it runs once for all pages."""
SPLIT = "docs/cookbook.md"
OPERATORS = "|><&;"


@dataclass(frozen=True)
class Section:
    """Commands of a page that are run one after the other in one folder, then its examples in Python."""

    name: str
    page: str
    commands: tuple[str, ...]
    examples: tuple[str, ...] = ()


def sections() -> Iterator[Section]:
    for page in sorted(PAGES):
        name = page.relative_to(ROOT).as_posix()
        text = page.read_text(encoding="utf-8")
        parts = text.split("\n## ") if name == SPLIT else [text]
        for part in parts:
            commands = tuple(commands_of(part))
            heading = part.partition("\n")[0].lstrip("# ")
            examples = tuple(blocks(part, "python")) if name == SPLIT else ()
            if commands or examples:
                yield Section(f"{name}: {heading}" if name == SPLIT else name, name, commands, examples)


def commands_of(text: str) -> Iterator[str]:
    """The commands of the console blocks without comments."""
    for block in blocks(text, "console"):
        for line in block.splitlines():
            assert line.startswith("$ "), f"a console block shows commands only: {line}"
            yield " ".join(words_of(line.removeprefix("$ ")))


def blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def words_of(line: str) -> list[str]:
    """The words and operators of a command line, with their quotes."""
    lexer = shlex.shlex(line, posix=False, punctuation_chars=OPERATORS)
    lexer.whitespace_split = True
    return list(lexer)


def reason(command: str) -> str:
    return next((why for pattern, why in NOT_RUN.items() if re.match(pattern, command)), "")


RUN = [section for section in sections() if not (section.commands and all(map(reason, section.commands)))]
README, *OTHERS = RUN
SECTIONS = [README, *some_of(OTHERS, len(OTHERS) // TURNS, lambda section: section.page)]


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("vehicle")
    write_files(folder)
    return folder


@pytest.fixture(scope="session")
def finished() -> dict[str, tuple[int, str, str]]:
    return {}


@pytest.fixture
def place(files: Path, invoke: Invoke, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The directory of the commands; pictures are drawn at once, and by day simulated LiDARs have white noise only."""
    del invoke
    copy_files(files, Path())
    if not NIGHTLY:
        monkeypatch.setattr(
            "multilica.simulate.simulate_snapshot",
            lambda *scene, **options: simulate_snapshot(*scene, **{**options, "sensors": "ideal"}),
        )
    monkeypatch.setattr("multilica.runs.run_report.viewer_picture", lambda *_: b"\x89PNG")
    return Path()


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.name)
def test_commands_of_a_page_run(
    section: Section, place: Path, invoke: Invoke, finished: dict[str, tuple[int, str, str]]
) -> None:
    if any(" jq " in command for command in section.commands) and shutil.which("jq") is None:
        pytest.skip("apt-get install jq")
    if any(".missing" in command for command in section.commands):
        lose_a_lidar(place)
    for command in section.commands:
        if not reason(command):
            code, out, err = finished.get(command) or run(command, invoke)
            assert code == ENDS.get(command, 0), f"{command}\n{out}\n{err}"
            assert not (" jq " in command and out.strip() in {"", "null"}), f"{command} answers nothing"
            if command == ALONE:
                finished[command] = code, out, err
                printed = iter(line.rstrip() for line in out.splitlines())
                assert [line for line in shown_in_the_readme() if line not in printed] == [], "the README shows others"
    names: dict[str, object] = {}
    for example in section.examples:
        exec(compile(example, section.name, "exec"), names)  # noqa: S102


def shown_in_the_readme() -> list[str]:
    """The lines of output that the README shows for `multilica demo`."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"\n\n```\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    return [line for line in shown.splitlines() if line]


def run(command: str, invoke: Invoke) -> tuple[int, str, str]:
    """Run `multilica` in this process, and what its output goes to in a shell."""
    words = words_of(command)
    end = next((index for index, word in enumerate(words) if set(word) <= set(OPERATORS)), len(words))
    assert words[0] == "multilica", f"run it, or tell in NOT_RUN why not: {command}"
    outcome = invoke(*(argument for word in words[1:end] for argument in expanded(word)))
    if end == len(words):
        return outcome.code, outcome.out, outcome.err
    Path(".printed").write_text(outcome.out, encoding="utf-8")
    script = f"{{ cat .printed; (exit {outcome.code}); }} {' '.join(words[end:])}"
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout, outcome.err + done.stderr


def expanded(word: str) -> list[str]:
    """A word as the shell gives it to a command: without quotes, with its pattern replaced by the files."""
    if "*" in word and word[0] not in "'\"":
        return sorted(str(path) for path in Path().glob(word))
    return [shlex.split(word)[0]]


def test_each_reason_is_needed() -> None:
    commands = [command for section in sections() for command in section.commands]
    assert [pattern for pattern in NOT_RUN if not any(re.match(pattern, command) for command in commands)] == []
    assert [command for command in ENDS if command not in commands] == []
