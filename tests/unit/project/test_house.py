# SPDX-License-Identifier: Apache-2.0
"""Rules for every file of the project."""

from __future__ import annotations

import ast
import gc
import importlib
import os
import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import UnionType

import pytest

import multilica
from tests.documentation.prose import OPENERS

ROOT = Path(__file__).parents[3]
UNTRACKED = {".git", ".venv", ".hypothesis", "node_modules", "__pycache__", "dist", "build"}
LICENSED_SUFFIXES = {".py", ".yaml", ".yml", ".js", ".mjs", ""}
TEXT_SUFFIXES = LICENSED_SUFFIXES | {".md", ".toml", ".json", ".txt"}
UNLICENSED = {"LICENSE", ".gitignore", ".gitattributes"}
BANNED = {
    "a path of one machine": r"(?<![\w.])/(work|farm|home|root|Users)/",
    "a package registry": r"https?://[a-z0-9.-]*(pypi|pythonhosted|debian\.org|npmjs)",
    "work put off": r"\b(TO" r"DO|FIX" r"ME|XX" r"X)\b",
    "a pictogram": "[\U0001f300-\U0001faff\u2600-\u27bf]",
    "a section ruler": r"^\s*#\s*[-=#*~]{4,}",
}

PRODUCT = {"multilica", "cli"}
MOST_LINES = 400
MOST_FILES = 20
LONGEST_TEST_NAME = 60
OLD_WORDS = re.compile("witness|testimony|retell|far_fetched|upheld", re.IGNORECASE)
NOT_A_VERB = re.compile("(The|An?|All|Every|Each|Those|It) ")
LABELS = ("What helps: ",)
"""Texts that are no sentence."""

Function = ast.FunctionDef | ast.AsyncFunctionDef


def project_files() -> Iterator[Path]:
    for folder, folders, names in os.walk(ROOT):
        outputs = {"runs"} if Path(folder) == ROOT / "recordings" else set()
        folders[:] = [name for name in folders if name not in UNTRACKED | outputs and not name.endswith("_cache")]
        yield from (Path(folder) / name for name in names if name not in UNTRACKED)  # .git is a file in a worktree


@cache
def all_files() -> list[Path]:
    return sorted(project_files())


@cache
def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def text_files() -> list[Path]:
    return [path for path in all_files() if path.suffix in TEXT_SUFFIXES and path.name != "LICENSE"]


@cache
def relative(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def files_below(folders: set[str], suffix: str = "") -> list[Path]:
    return [path for path in all_files() if relative(path).split("/")[0] in folders and path.name.endswith(suffix)]


def nodes_below(folders: set[str], kind: type[ast.AST] | UnionType) -> Iterator[tuple[str, ast.AST]]:
    for path in files_below(folders, ".py"):
        for node in nodes_of(path):
            if isinstance(node, kind):
                yield f"{relative(path)}:{node.lineno}", node


@cache
def nodes_of(path: Path) -> list[ast.AST]:
    gc.disable()  # a tree is no garbage, and the search for it takes longer than the parser
    try:
        return [*ast.walk(ast.parse(text_of(path)))]
    finally:
        gc.enable()


def listed(offenders: list[str], rule: str) -> str:
    return "\n".join([f"{len(offenders)} break the rule: {rule}", *offenders])


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
    assert {"multilica/runs/__init__.py", "tests/unit/project/test_house.py"} <= names
    assert {"multilica", "multilica.pipeline", "multilica_cli.main"} <= set(modules())


def test_each_source_begins_with_its_licence() -> None:
    licensed = [path for path in text_files() if path.suffix in LICENSED_SUFFIXES and path.name not in UNLICENSED]
    assert [relative(path) for path in licensed if not has_licence(path)] == []


def has_licence(path: Path) -> bool:
    head = text_of(path).splitlines()[:2]
    first = head[1:] if head and head[0].startswith("#!") else head
    return bool(first) and "SPDX-License-Identifier: Apache-2.0" in first[0]


@pytest.mark.parametrize("fault", BANNED)
def test_no_file_holds(fault: str) -> None:
    pattern = re.compile(BANNED[fault], re.MULTILINE)
    found = [relative(path) for path in text_files() if pattern.search(text_of(path))]
    assert found == [], f"{fault} stands in these files"


def test_only_packages_list_their_names() -> None:
    declared = re.compile(r"^__all__\b", re.MULTILINE)
    lists = [path for path in files_below(PRODUCT, ".py") if declared.search(text_of(path))]
    assert [relative(path) for path in lists if path.name != "__init__.py"] == []
    for path in lists:
        loaded = importlib.import_module(".".join(path.relative_to(ROOT).parts[:-1]))
        assert len({*loaded.__all__}) == len(loaded.__all__)
        assert [name for name in loaded.__all__ if not hasattr(loaded, name)] == []


def test_the_package_finds_its_public_names() -> None:
    assert dir(multilica) == sorted(multilica.__all__)
    with pytest.raises(AttributeError, match="no_such_name"):
        multilica.no_such_name  # noqa: B018


def test_no_file_is_empty() -> None:
    assert {relative(path) for path in all_files() if not path.stat().st_size} == {"multilica/py.typed"}


def test_names_of_tests_are_short() -> None:
    test = re.compile(r"^ *(?:async )?def (test_\w+)", re.MULTILINE)
    names = ((path, name) for path in files_below({"tests"}, ".py") for name in test.findall(text_of(path)))
    long = [f"{relative(path)} {name} ({len(name)})" for path, name in names if len(name) > LONGEST_TEST_NAME]
    assert not long, listed(long, f"a test's name has at most {LONGEST_TEST_NAME} characters")


def test_sources_are_short() -> None:
    lines = {path: text_of(path).count("\n") for path in files_below(PRODUCT | {"tests"}, ".py")}
    long = [f"{relative(path)} ({count})" for path, count in lines.items() if count > MOST_LINES]
    assert not long, listed(long, f"a source has at most {MOST_LINES} lines")


def test_folders_are_small() -> None:
    counts = Counter(path.parent for path in files_below(PRODUCT | {"tests", "docs"}))
    full = [f"{relative(folder)} ({count})" for folder, count in counts.items() if count > MOST_FILES]
    assert not full, listed(full, f"a folder has at most {MOST_FILES} files")


def test_packages_have_several_modules() -> None:
    packages = [path.parent for path in files_below(PRODUCT, "__init__.py")]
    lonely = [relative(package) for package in packages if len(members(package)) == 1]
    assert not lonely, listed(lonely, "a package has more than one module or package")


def members(package: Path) -> list[Path]:
    return [*package.glob("[!_]*.py"), *package.glob("__main__.py"), *package.glob("*/__init__.py")]


def test_old_words_are_gone() -> None:
    found = [
        f"{relative(path)}:{number} {line}"
        for path in files_below(PRODUCT)
        for number, line in enumerate([path.name, *text_of(path).splitlines()])
        if OLD_WORDS.search(line)
    ]
    assert not found, listed(found, f"no name or text has {OLD_WORDS.pattern}")


def test_class_names_are_unique() -> None:
    places = defaultdict(list)
    for place, node in nodes_below(PRODUCT, ast.ClassDef):
        places[node.name].append(place)
    shared = [f"{name}: {', '.join(found)}" for name, found in sorted(places.items()) if len(found) > 1]
    assert not shared, listed(shared, "no two classes of the product have one name")


def test_docstrings_of_functions_start_with_a_verb() -> None:
    clauses = [
        f"{place} {node.name}: {docstring.splitlines()[0]}"
        for place, node in nodes_below(PRODUCT, Function)
        if NOT_A_VERB.match(docstring := ast.get_docstring(node) or "")
        and not any("property" in ast.unparse(decorator) for decorator in node.decorator_list)
    ]
    assert not clauses, listed(clauses, "a function's docstring starts with a verb in the imperative")


def test_no_sentence_of_the_product_opens_with_a_clause() -> None:
    texts = [(place, node.value) for place, node in nodes_below(PRODUCT, ast.Constant) if isinstance(node.value, str)]
    clauses = [f"{place}: {clause}" for place, text in [*texts, *comments()] for clause in clauses_in(text)]
    assert not clauses, listed(clauses, "a sentence of a docstring, comment or message opens with its subject")


def comments() -> Iterator[tuple[str, str]]:
    for path in files_below(PRODUCT, ".py"):
        lines = text_of(path).splitlines()
        yield from (
            (f"{relative(path)}:{at}", line.lstrip(" #")) for at, line in enumerate(lines, 1) if "# " in line[:50]
        )


def clauses_in(text: str) -> list[str]:
    """The sentences that open with a clause, as on the pages of the documentation."""
    if text.lstrip().startswith(LABELS):
        return []
    sentences = (sentence.strip() for sentence in re.split(r"(?<=[.!?])\s+|\n\s*\n", text))
    return [each for each in sentences if OPENERS.match(each) and each[0].isupper() and not each.endswith("?")]


@pytest.mark.parametrize(
    "text", ["What is found.", "It ends. Of two, one is kept.", "Return it.\n\n    Where it is.\n"]
)
def test_a_clause_in_a_text_is_found(text: str) -> None:
    assert len(clauses_in(text)) == 1
    assert clauses_in(text.replace(".", "?")) == clauses_in(f"See {text.split(maxsplit=1)[0].lower()} it is.") == []
