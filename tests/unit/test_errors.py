# SPDX-License-Identifier: Apache-2.0
"""Messages that hold what a file says."""

from __future__ import annotations

import pytest

from multilica.errors import ConfigError, UnknownNameError, UnreadableSourceError, escape_controls, listed


def test_a_long_message_keeps_its_beginning_and_its_end() -> None:
    text = str(UnreadableSourceError(f"The file has {'x' * 10_000}; expected less."))
    assert len(text) == 500
    assert text.startswith("The file has xxx")
    assert text.endswith("xxx; expected less.")
    assert str(ConfigError("short.")) == "short."


@pytest.mark.parametrize("code", [0x00, 0x0A, 0x1B, 0x7F, 0x9B, 0x200E, 0x200F, 0x202A, 0x202E, 0x2066, 0x2069, 0x2028])
def test_characters_that_a_terminal_obeys_are_escaped(code: int) -> None:
    for text in (escape_controls(f"a{chr(code)}b"), str(UnknownNameError("topic", chr(code), ["/a"]))):
        assert text.isprintable()
        assert (f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}") in text


def test_letters_of_all_languages_stay() -> None:
    assert escape_controls("Größe مرحبا 前 \u0301") == "Größe مرحبا 前 \u0301"


@pytest.mark.parametrize(
    ("count", "said"),
    [(0, ""), (2, "t0, t1"), (21, "t0, t1, t2, t3, t4 and 16 more"), (300, "t0, t1, t2, t3, t4 and 295 more")],
)
def test_many_names_are_told_by_their_number(count, said):
    assert listed([f"t{number}" for number in range(count)]) == said
    assert listed([f"t{number}" for number in range(20)]).endswith("t18, t19")
