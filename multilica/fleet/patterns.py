# SPDX-License-Identifier: Apache-2.0
"""Vehicle and time in the path of a log."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime

from multilica.errors import UsageError
from multilica.ingest.formats import FORMATS, name_unpacked

_FIELD = re.compile(r"\{(vehicle|time)(?::([^{}]+))?\}")
_BRACES = re.compile(r"\{[^{}]*\}|[{}]")
_ENDLESS = re.compile(r"\*\{vehicle[^{}]*\}|\{vehicle[^{}]*\}\*")
_DIRECTIVES = {
    "Y": r"\d{4}",
    "m": r"(?:0[1-9]|1[0-2])",
    "d": r"(?:0[1-9]|[12]\d|3[01])",
    "H": r"(?:[01]\d|2[0-3])",
    "M": r"[0-5]\d",
    "S": r"[0-5]\d",
    "y": r"\d{2}",
    "j": r"\d{3}",
}
"""Letter of a directive of `strptime` -> its digits."""
_SUFFIXES = sorted((suffix for entry in FORMATS.values() for suffix in entry.suffixes), key=len, reverse=True)


class LogPattern:
    """Vehicle and time in the path of a log.

    Args:
        text: such as ``{vehicle}/{time:%Y-%m-%d_%H%M%S}``; it is searched for anywhere in the path. A ``*`` stands for
            any characters within a folder's name. A vehicle at the end is the rest of a folder's name, or of a file's
            without its suffix. Digits of a time are no part of a longer number, unless a ``*`` follows. Times are UTC.

    Raises:
        UsageError: no field, one twice, other braces, a vehicle without an end, a part of a time that is not
            supported, or a time without a date.
    """

    def __init__(self, text: str) -> None:
        fields = [found[1] for found in _FIELD.finditer(text)]
        if not fields or len({*fields}) < len(fields):
            raise UsageError(
                f"Found the pattern '{text}'; expected {{vehicle}}, {{time:%Y-%m-%d}} or both, for example "
                "{vehicle}/{time:%Y-%m-%d_%H%M%S}."
            )
        if unknown := _BRACES.search(_FIELD.sub("", text)):
            raise UsageError(
                f"Found {unknown[0]} in the pattern '{text}'; expected {{vehicle}} or {{time:%Y-%m-%d}}, and * for "
                "characters that do not matter."
            )
        if endless := _ENDLESS.search(text):
            raise UsageError(
                f"Found {endless[0]} in the pattern '{text}'; expected a character between {{vehicle}} and *, as the "
                "name has no end otherwise."
            )
        self.text, self._time_format = text, ""
        parts = _FIELD.split(text)
        pattern = _literal(parts[0])
        for at in range(1, len(parts), 3):
            before, name, time_format, after = parts[at - 1 : at + 3]
            pattern += self._time(time_format, before, after) if name == "time" else _vehicle(parts, at)
            pattern += _literal(after)
        self._pattern = re.compile(pattern)

    def of(self, source: str) -> tuple[str, int | None] | None:
        """Return vehicle and time in nanoseconds, empty and None if not asked for; None if the path does not fit."""
        found = self._pattern.search(source)
        while found is not None:
            fields = found.groupdict()
            vehicle = fields.get("vehicle") or ""
            if vehicle and found.end("vehicle") == len(source):
                vehicle = _without_suffix(vehicle)
            if not self._time_format:
                return vehicle, None
            time_ns = self._time_ns(fields["time"])
            if time_ns is not None:
                return vehicle, time_ns
            found = self._pattern.search(source, found.start() + 1)
        return None

    def _time_ns(self, text: str) -> int | None:
        """Return a time in nanoseconds; None for digits that are no date."""
        try:
            begin = datetime.strptime(text, self._time_format).replace(tzinfo=UTC)
        except ValueError:
            return None
        # Day 366 of a short year is read as the first of the next.
        return round(begin.timestamp()) * 10**9 if begin.strftime(self._time_format) == text else None

    def _time(self, given: str | None, before: str, after: str) -> str:
        """Return the expression of a time between two literal texts."""
        self._time_format = given or "%Y-%m-%d"
        parts = re.split(r"%(.)", self._time_format)
        self._require_date(parts[1::2])
        digits = [_DIRECTIVES[part] if index % 2 else re.escape(part) for index, part in enumerate(parts)]
        begin = "" if before[-1:].isdigit() else r"(?<!\d)"
        end = "" if after[:1].isdigit() or after.startswith("*") else r"(?!\d)"
        return f"{begin}(?P<time>{''.join(digits)}){end}"

    def _require_date(self, directives: Sequence[str]) -> None:
        if unknown := {*directives} - _DIRECTIVES.keys():
            raise UsageError(
                f"Found %{min(unknown)} in the pattern '{self.text}'; expected %Y, %m, %d, %H, %M, %S, %y or %j."
            )
        has_day = {"m", "d"} <= {*directives} or "j" in directives
        if not has_day or len({"Y", "y"} & {*directives}) != 1 or len({*directives}) < len(directives):
            raise UsageError(
                f"Found the time {self._time_format} in the pattern '{self.text}'; expected a year (%Y or %y) with "
                "month and day (%m and %d) or with the day of the year (%j), each of them once."
            )


def _literal(text: str) -> str:
    return "[^/]*".join(re.escape(part) for part in text.split("*"))


def _vehicle(parts: Sequence[str], at: int) -> str:
    """Return the expression of a vehicle; one at an end of the pattern reaches to the end of the folder's name."""
    begin = r"(?<![^/])" if not "".join(part or "" for part in parts[:at]) else ""
    is_last = not "".join(part or "" for part in parts[at + 2 :])
    return f"{begin}(?P<vehicle>[^/]+{'' if is_last else '?'})"


def _without_suffix(name: str) -> str:
    """Return the name of a file without the suffixes of its format and compression; others are part of a name."""
    plain = name_unpacked(name)
    suffix = next((each for each in _SUFFIXES if plain.lower().endswith(each)), "")
    return plain[: len(plain) - len(suffix)] or name
