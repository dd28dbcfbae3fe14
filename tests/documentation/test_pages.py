# SPDX-License-Identifier: Apache-2.0
"""What the documentation shows works."""

from __future__ import annotations

import functools
import re
from pathlib import Path

import pytest

from docs.site.generated_pages import FOLDER, generated_pages
from multilica_cli.exit_codes import ExitCode
from tests.cli.support import ROOT, Invoke

PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
ABOUT_SOURCES = [page for page in PAGES if page.name not in {"CHANGELOG.md", "cookbook.md"}]
"""The cookbook has folders of a user, the changelog names that are gone."""
OF_OTHERS = {"evaluation_rel.py", "evaluation.py"}
"""Sources of the published code of the paper."""
FOLDERS = ("multilica", "cli", "tests", "docs")


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


@pytest.mark.slow
def test_the_readme_example_runs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(ROOT)
    (example,) = blocks(ROOT / "README.md", "python")
    exec(compile(example, "README.md", "exec"), {})  # noqa: S102
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["front", "left", "rear", "right"]
    assert all(line.count("[") == 2 for line in lines)


def shown_options() -> list[tuple[str, str]]:
    found = set()
    for page in PAGES:
        for block in blocks(page, "console"):
            for command, rest in re.findall(r"multilica ((?:fleet )?\w+)([^#|\n]*)", block):
                found.update((command, option) for option in re.findall(r"--[a-z-]+", rest))
    return sorted(found)


@pytest.mark.parametrize(("command", "option"), shown_options())
def test_shown_options_exist(command: str, option: str, invoke: Invoke) -> None:
    outcome = invoke(*command.split(), "--help")
    assert outcome.code == ExitCode.DONE
    assert re.search(rf"{option}\b", outcome.out)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page: Path) -> None:
    links = re.findall(r"\]\((?!https?://|#)([^)#]+)", page.read_text(encoding="utf-8"))
    assert [link for link in links if not (page.parent / link).exists()] == []


@pytest.mark.slow
def test_generated_pages_are_up_to_date() -> None:
    found = {name: (FOLDER / name).read_text(encoding="utf-8") for name in generated_pages()}
    assert [name for name, text in generated_pages().items() if found[name] != text] == [], "run `make docs`"


@pytest.mark.parametrize("page", ABOUT_SOURCES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_sources_that_a_page_names_exist(page: Path) -> None:
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    named = set(re.findall(r"`([\w./-]+(?:\.py|/))`", text)) - OF_OTHERS
    assert sorted(name for name in named if not any(source.endswith(f"/{name}") for source in sources())) == []


def test_modules_of_the_architecture_exist() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    packages = text.split("## Packages\n")[1].split("\n## ")[0]
    modules = {Path(source).stem for source in sources()}
    assert sorted(set(re.findall(r"`([a-z_]+)`", packages)) - modules) == []


@functools.cache
def sources() -> tuple[str, ...]:
    """The sources of the project, and its folders with a slash at their end."""
    files = [path.relative_to(ROOT) for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")]
    folders = {folder for path in files for folder in path.parents}
    return (*(f"/{path.as_posix()}" for path in files), *(f"/{folder.as_posix()}/" for folder in folders))


def test_every_decision_is_listed() -> None:
    listed = re.findall(
        r"^- \[.*\]\((.*)\)$", (ROOT / "docs/decisions/index.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert listed == sorted(path.name for path in ROOT.glob("docs/decisions/0*.md"))
