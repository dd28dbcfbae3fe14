# SPDX-License-Identifier: Apache-2.0
"""Sentences of the prose in a Markdown page."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

HIDDEN = re.compile(r"^(```|~~~).*?^\1[^\n]*$|<!--.*?-->|^> .*?$", re.MULTILINE | re.DOTALL)
"""Code, comments, and block quotes, which show output of the program."""
NEW_PARAGRAPH = re.compile(r"^\s*([-*] |\d+\. )")
END = re.compile(r"(?<=[.?!:])[)\"*_]*\s+(?=[\"(*_]*[A-Z`\[])|(?<!\\)\|")
"""The end of a sentence, before one that opens with a capital, code or a link; or of a cell of a table."""
ABBREVIATION = re.compile(r"\b(e\.g|i\.e|et al|vs|cf)\.")
SPAN = re.compile(r"`[^`\n]*`|\"[^\"\n]*\"")
"""Code, or a text that is quoted."""
LINK = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")

OPENERS = re.compile(r"(Of(?! course)|What|Whether|Where|Why|How|Who|That of)\b", re.IGNORECASE)
"""First words of a clause that a reader has to keep in mind until its verb comes."""
MOST_WORDS = 30


@dataclass(frozen=True)
class Sentence:
    """A sentence, with the line of the page that its paragraph starts on."""

    line: int
    text: str

    @property
    def opens_with_a_clause(self) -> bool:
        return OPENERS.match(self.text) is not None and not self.text.endswith("?")

    @property
    def words(self) -> int:
        """Words of the longest part between semicolons or colons."""
        return max(len(part.split()) for part in re.split(r"[;:]\s", self.text))


def sentences(page: str) -> Iterator[Sentence]:
    """Yield the sentences outside headings, quoted output and code; a span of code counts as one word."""
    for line, paragraph in paragraphs(page):
        text = ABBREVIATION.sub(r"\1", LINK.sub(r"\1", SPAN.sub("`code`", paragraph)))
        parts = (part.strip(" *_(\t") for part in END.split(text))
        yield from (Sentence(line, part) for part in parts if part)


def paragraphs(page: str) -> Iterator[tuple[int, str]]:
    """Yield each paragraph, item of a list and row of a table as one line, with its line number."""
    text = HIDDEN.sub(lambda found: "\n" * found[0].count("\n"), page)
    start, lines = 0, list[str]()
    for number, line in enumerate([*text.splitlines(), ""], 1):
        is_row = line.lstrip().startswith("|")
        is_prose = bool(line.strip()) and not is_row and not line.startswith("#")
        if lines and (not is_prose or NEW_PARAGRAPH.match(line)):
            yield start, " ".join(lines)
            lines = []
        if is_row:
            yield number, line
        elif is_prose:
            start = start if lines else number
            lines.append(NEW_PARAGRAPH.sub("", line).strip())
