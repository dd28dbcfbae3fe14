# SPDX-License-Identifier: Apache-2.0
"""Sentences of the pages are read once: they open with their subject, and are short."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.support import ROOT
from tests.documentation.prose import MOST_WORDS, sentences

PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])

page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())


@page
def test_no_sentence_opens_with_a_clause(page: Path) -> None:
    found = sentences(page.read_text(encoding="utf-8"))
    assert [f"{page.name}:{each.line} {each.text}" for each in found if each.opens_with_a_clause] == []


@page
def test_sentences_are_short(page: Path) -> None:
    found = sentences(page.read_text(encoding="utf-8"))
    long = [f"{page.name}:{each.line} {each.words} words: {each.text}" for each in found if each.words > MOST_WORDS]
    assert long == [], f"a sentence has at most {MOST_WORDS} words between colons and semicolons"


@pytest.mark.parametrize(
    "text",
    [
        "Of 20 LiDARs, 19 are placed.",
        "It ends. How far a run gets depends on the machine.",
        "- Where `code` is null,\n  nothing changed.",
        "| `key` | whether it is placed |",
        "**Of** all poses, the best is kept.",
        "See [this page](a.md). [What helps](b.md) is there.",
    ],
)
def test_a_clause_is_found(text: str) -> None:
    assert [each.opens_with_a_clause for each in sentences(text)].count(True) == 1


@pytest.mark.parametrize(
    "text",
    [
        "## What failures look like",
        "Where was each LiDAR?",
        "| Which LiDARs moved? | What is placed? |",
        '```\nWhat helps: a scene\n```\nIt says "What helps".',
        "> Of 3 LiDARs, 1 is placed.",
        "It says where it is. Of course. However, `What` is code. Office hours.",
    ],
)
def test_questions_headings_and_output_are_no_clauses(text: str) -> None:
    assert not any(each.opens_with_a_clause for each in sentences(text))


def test_words_are_counted_between_stops() -> None:
    (long,) = sentences("word " * 20 + "word; " + "word " * 30 + "last.")
    assert long.words == MOST_WORDS + 1
    assert [each.words for each in sentences("One `a b c` two. Three, e.g. four: five.")] == [3, 3]
