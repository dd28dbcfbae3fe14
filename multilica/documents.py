# SPDX-License-Identifier: Apache-2.0
"""The guarded loader of TOML, JSON and YAML documents.

Every document that a user or a file hands over passes here before its pydantic model sees it: limits of size, depth,
and numbers. `tomllib`, `json` and `ruamel.yaml` have none of their own, recurse, and build integers of any length.
"""

import json
import os
import re
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from pydantic import ValidationError

LFS_POINTER = b"version https://git-lfs.github.com/spec/"
"""First bytes of the text that stands for a file in a checkout without Git LFS."""
MAX_JSON_BYTES = 64 << 20
"""The result of 20 LiDARs takes a few megabytes."""
MAX_TOML_BYTES = 1 << 20
"""The poses of a hundred LiDARs take a tenth of it."""
MAX_YAML_BYTES = 256 << 10
"""The poses of a hundred LiDARs take a tenth of it; the parser needs seconds for more."""
MAX_LENGTH_M = 1e8
"""Twice the way around the Earth: longer lengths are mistakes, and their squares overflow."""

_MAX_DEPTH = 64
_MAX_NUMBER = 2.0**63
"""As nanoseconds since the epoch the year 2262."""
_MAX_VALUES = 4_000_000
"""Values that `json` may build; a list counts as four."""
_MAX_SHOWN = 60
# Possessive, so that the search stays linear.
_LONG_KEY = re.compile(rb"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){%d}""" % _MAX_DEPTH)
# The YAML parser reads a thousand brackets ahead before it reports the first, in quadratic time.
_DEEP_FLOW = re.compile(rf"(?:[\[{{]\s*+){{{_MAX_DEPTH + 1}}}")


class DocumentError(ValueError):
    """A document that cannot be used; the text is a clause, as in "it is nested more than 64 levels deep"."""


def local_path(given: str | Path) -> Path:
    """Return the path that a user gives; ``~`` stands for the home folder, and a name may begin with it, as ``./~old``.

    `Path` drops the ``./``, and refuses a user that does not exist.
    """
    return Path(os.path.expanduser(given))  # noqa: PTH111


def read_limited(path: Path, max_bytes: int) -> bytes:
    """Read a file of at most `max_bytes`, whatever it claims its size to be.

    Raises:
        DocumentError: it is larger.
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        data = file.read(max_bytes + 1)
    _sized(data, max_bytes)
    if data.startswith(LFS_POINTER):
        raise DocumentError("it is a pointer of Git LFS, not the file; get the file with `git lfs pull`")
    return data


def parse_toml(data: bytes | str) -> dict[str, Any]:
    """Parse a TOML document; raise DocumentError if it is not valid or exceeds a limit."""
    data = _sized(data, MAX_TOML_BYTES)
    if _LONG_KEY.search(data):
        raise _too_deep()
    with _clauses():
        table = tomllib.loads(data.decode("utf-8"))
    _require_plain(table)
    return table


def parse_json(data: bytes | str) -> Any:  # noqa: ANN401 - any JSON value
    """Parse a JSON document; raise DocumentError if it is not valid or exceeds a limit."""
    data = _sized(data, MAX_JSON_BYTES)
    if data.count(b",") + 4 * (data.count(b"[") + data.count(b"{")) > _MAX_VALUES:
        raise DocumentError("it has millions of values")
    with _clauses():
        value = json.loads(data.decode("utf-8"), parse_constant=_refuse_constant)
    _require_plain(value)
    return value


def parse_yaml(data: bytes | str) -> Any:  # noqa: ANN401 - any YAML value
    """Parse a YAML 1.2 document without aliases and tags; raise DocumentError if it is not valid or exceeds a limit."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    data = _sized(data, MAX_YAML_BYTES)
    with _clauses():
        text = data.decode("utf-8")
        try:
            if _DEEP_FLOW.search(text):
                raise _too_deep()
            _require_plain_events(YAML(typ="safe", pure=True).parse(text))
            value = YAML(typ="safe", pure=True).load(text)
        except YAMLError as error:
            parts = (getattr(error, name, None) for name in ("context", "problem"))
            mark = getattr(error, "problem_mark", None)
            where = f" in line {mark.line + 1}" if mark is not None else ""
            raise ValueError(f"{', '.join(filter(None, parts)) or 'it is not YAML'}{where}") from error
    _require_plain(value)
    return value


def _require_plain_events(events: Iterable[Any]) -> None:
    """Check a YAML document before its values are built, which recurses and follows aliases."""
    from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent, ScalarEvent

    depth = 0
    for event in events:
        if isinstance(event, AliasEvent):
            raise DocumentError("it has an alias, which is not read; write the value out")
        if isinstance(event, CollectionStartEvent | ScalarEvent) and event.tag is not None:
            raise DocumentError(f"it has the tag {shown(str(event.tag))}, which is not read")
        if isinstance(event, CollectionStartEvent | CollectionEndEvent):
            depth += 1 if isinstance(event, CollectionStartEvent) else -1
        if depth > _MAX_DEPTH:
            raise _too_deep()


def first_problem(error: ValidationError) -> tuple[str, str, object]:
    """Return the place of a model's first problem, as ``section.key``, its meaning as a clause, and what was found."""
    first = error.errors(include_url=False, include_context=False)[0]
    if first["type"] == "model_type":
        return ".".join(map(str, first["loc"])), "expected a table of keys", first["input"]
    what = first["msg"].removeprefix("Value error, ").removeprefix("Assertion failed, ")
    return ".".join(map(str, first["loc"])), f"{what[:1].lower()}{what[1:]}", first["input"]


def shown(value: object) -> str:
    """Return a value for a message, in a few characters."""
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > _MAX_NUMBER:
        return "an integer of more than 18 digits"
    if isinstance(value, str) and len(value) > _MAX_SHOWN:
        value = f"{value[:_MAX_SHOWN]}..."
    text = repr(value)
    return text if len(text) <= 2 * _MAX_SHOWN else f"{text[:_MAX_SHOWN]}..."


def require_length(value_m: float) -> float:
    """Return a length in metres; raise ValueError, with a clause as its text, if it is longer than `MAX_LENGTH_M`."""
    if not abs(value_m) <= MAX_LENGTH_M:
        raise ValueError(f"expected metres up to {MAX_LENGTH_M:g}, found {value_m:g}")
    return value_m


def _sized(data: bytes | str, max_bytes: int) -> bytes:
    """Return a document as bytes; raise DocumentError if it has more than `max_bytes`."""
    data = data.encode("utf-8", "surrogatepass") if isinstance(data, str) else data
    if len(data) > max_bytes:
        raise DocumentError(f"it has more than {max_bytes} bytes")
    return data


@contextmanager
def _clauses() -> Iterator[None]:
    """Turn the errors of a parser into DocumentError; YAML's dates, keys and numbers have no errors of their own."""
    try:
        yield
    except DocumentError:
        raise
    except RecursionError as error:
        raise _too_deep() from error
    except (ValueError, TypeError, ArithmeticError, LookupError, AttributeError) as error:
        text = " ".join(str(error).split()).rstrip(".")
        long = "integer string conversion" in text
        raise DocumentError("it has a number of thousands of digits" if long else text) from error


def _require_plain(document: object) -> None:
    """Check depth and numbers, without recursion."""
    waiting: list[tuple[object, str, int]] = [(document, "", 0)]
    while waiting:
        value, name, depth = waiting.pop()
        if isinstance(value, dict | list):
            if depth >= _MAX_DEPTH:
                raise _too_deep()
            named = value.items() if isinstance(value, dict) else ((None, item) for item in value)
            within = f"{name}." if name else ""
            waiting.extend((item, name if key is None else f"{within}{key}", depth + 1) for key, item in named)
        elif isinstance(value, float | int) and not abs(value) <= _MAX_NUMBER:
            raise DocumentError(f"{name or 'it'} is {shown(value)}; expected a number up to {_MAX_NUMBER:.2g}")


def _too_deep() -> DocumentError:
    return DocumentError(f"it is nested more than {_MAX_DEPTH} levels deep")


def _refuse_constant(name: str) -> NoReturn:
    raise DocumentError(f"it has the number {name}, which is not finite")
