# SPDX-License-Identifier: Apache-2.0
"""What holds for every file of the project."""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import multilica

ROOT = Path(__file__).parents[2]
UNTRACKED = {".git", ".venv", ".hypothesis", "node_modules", "__pycache__", "runs", "dist", "build"}
LICENSED_SUFFIXES = {".py", ".yaml", ".yml", ".js", ".mjs", ""}
TEXT_SUFFIXES = LICENSED_SUFFIXES | {".md", ".toml", ".json", ".txt"}
UNLICENSED = {"LICENSE", ".gitignore", ".gitattributes"}
HEAVY = {"open3d", "rerun", "scipy", "numpy", "mcap", "rosbags", "foxglove", "small_gicp", "kiss_matcher"}
BANNED = {
    "a path of one machine": r"(?<![\w.])/(work|farm|home|root|Users)/",
    "a package registry": r"https?://[a-z0-9.-]*(pypi|pythonhosted|debian\.org|npmjs)",
    "work put off": r"\b(TO" r"DO|FIX" r"ME|XX" r"X)\b",
    "a pictogram": "[\U0001f300-\U0001faff\u2600-\u27bf]",
    "a section ruler": r"^\s*#\s*[-=#*~]{4,}",
}


def project_files() -> Iterator[Path]:
    for folder, folders, names in os.walk(ROOT):
        folders[:] = [name for name in folders if name not in UNTRACKED and not name.endswith("_cache")]
        yield from (Path(folder) / name for name in names)


def text_files() -> list[Path]:
    return sorted(path for path in project_files() if path.suffix in TEXT_SUFFIXES and path.name != "LICENSE")


def relative(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def modules() -> list[str]:
    found = []
    for root in (ROOT / "multilica", ROOT / "cli" / "multilica_cli"):
        for path in sorted(root.rglob("*.py")):
            parts = path.relative_to(root.parent).with_suffix("").parts
            found.append(".".join(parts[:-1] if parts[-1] == "__init__" else parts))
    return [name for name in found if not name.endswith("__main__")]


def test_the_walk_sees_the_project() -> None:
    names = {relative(path) for path in text_files()}
    assert {"multilica/errors.py", "cli/multilica_cli/main.py", "Makefile", ".ci/run", "README.md"} <= names
    assert {"multilica", "multilica.pipeline", "multilica_cli.main"} <= set(modules())


def test_each_source_begins_with_its_licence() -> None:
    licensed = [path for path in text_files() if path.suffix in LICENSED_SUFFIXES and path.name not in UNLICENSED]
    assert [relative(path) for path in licensed if not has_licence(path)] == []


def has_licence(path: Path) -> bool:
    head = path.read_text(encoding="utf-8").splitlines()[:2]
    first = head[1:] if head and head[0].startswith("#!") else head
    return bool(first) and "SPDX-License-Identifier: Apache-2.0" in first[0]


@pytest.mark.parametrize("fault", BANNED)
def test_no_file_holds(fault: str) -> None:
    pattern = re.compile(BANNED[fault], re.MULTILINE)
    found = [relative(path) for path in text_files() if pattern.search(path.read_text(encoding="utf-8"))]
    assert found == [], f"{fault} stands in these files"


@pytest.mark.parametrize("module", modules())
def test_exported_names_exist(module: str) -> None:
    loaded = importlib.import_module(module)
    exported = getattr(loaded, "__all__", [])
    assert len(set(exported)) == len(exported)
    assert [name for name in exported if not hasattr(loaded, name)] == []
    if not loaded.__file__.endswith("__init__.py"):
        assert exported, f"{module} exports nothing"


def test_the_package_finds_its_public_names() -> None:
    assert dir(multilica) == sorted(multilica.__all__)
    with pytest.raises(AttributeError, match="no_such_name"):
        multilica.no_such_name  # noqa: B018


def imported_by(code: str) -> set[str]:
    listing = "\nimport sys; print(' '.join(sys.modules))"
    outcome = subprocess.run(
        [sys.executable, "-c", code + listing], capture_output=True, text=True, check=True, cwd=ROOT, env=environment()
    )
    return {name.partition(".")[0] for name in outcome.stdout.splitlines()[-1].split()}


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'cli'}"}


def test_importing_the_package_stays_light() -> None:
    assert imported_by("import multilica") & HEAVY == set()


@pytest.mark.parametrize("arguments", [["--help"], ["calibrate", "--help"], ["--version"], []])
def test_help_stays_light(arguments: list[str]) -> None:
    loaded = imported_by(f"from multilica_cli.main import run; run({arguments!r})")
    assert "typer" in loaded
    assert loaded & HEAVY == set()
