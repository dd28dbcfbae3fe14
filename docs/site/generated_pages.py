# SPDX-License-Identifier: Apache-2.0
"""The pages of `docs/reference` that are made from the code; `make docs` writes them, a test compares them."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic.json_schema import GenerateJsonSchema

from multilica.results.document import ResultDocument
from multilica.sinks.text.markdown import markdown_table
from multilica_cli.commands.config import configuration_page

FOLDER = Path(__file__).resolve().parents[1] / "reference"
_MADE = "<!-- Made by `make docs`. -->\n\n"
_SHAPES = frozenset({"Matrix4", "Matrix6", "Quaternion", "Row4", "Row6", "Vector3"})
_RESULT_HEAD = """# result.json

`result.json` holds everything about a run, for programs. [A JSON schema](result.schema.json) says the same.
`multilica explain --json` answers the usual questions without reading it.

"""


def generated_pages() -> dict[str, str]:
    """Return the text of each file, by its name in `FOLDER`."""
    return {
        "cli.md": cli_page(),
        "configuration.md": configuration_page(),
        "result.md": result_page(json.loads(schema_text())),
        "result.schema.json": f"{schema_text()}\n",
    }


class UntitledSchema(GenerateJsonSchema):
    """A schema without titles of fields, which only repeat their names."""

    def field_title_should_be_set(self, schema: object) -> bool:  # noqa: ARG002
        """Leave out every title."""
        return False


def schema_text() -> str:
    """Return the text of `docs/reference/result.schema.json`."""
    schema = ResultDocument.model_json_schema(schema_generator=UntitledSchema)
    return json.dumps({"$schema": UntitledSchema.schema_dialect, **schema}, indent=1, ensure_ascii=False)


def cli_page() -> str:
    """Return Typer's own page of the commands, with whole sentences in its lists of commands."""
    command = [sys.executable, "-m", "typer", "multilica_cli.main", "utils", "docs"]
    names = ("--name", "multilica", "--title", "Command line")
    page = subprocess.run([*command, *names], check=True, capture_output=True, text=True).stdout.rstrip()
    page = page.replace("```console\n$ ", "```text\n")
    summaries = dict(re.findall(r"^##+ `multilica (.+)`\n\n(.+)", page, re.MULTILINE))
    parts = re.split(r"^(?=##+ `multilica )", page, flags=re.MULTILINE)
    return _MADE + "".join(_with_whole_sentences(part, summaries) for part in parts) + "\n"


def _with_whole_sentences(part: str, summaries: Mapping[str, str]) -> str:
    heading = re.match(r"##+ `multilica (.+)`", part)
    above = f"{heading[1]} " if heading else ""

    def line(match: re.Match[str]) -> str:
        name = above + match[1]
        return f"* [`{name}`](#multilica-{name.replace(' ', '-')}): {summaries[name]}"

    before, title, commands = part.partition("**Commands**:\n")
    return before + title + re.sub(r"^\* `([\w-]+)`: .*", line, commands, flags=re.MULTILINE)


def result_page(schema: Mapping[str, Any]) -> str:
    """Return a table for the document and for each type of entry in it, in the order of their first use."""
    entries = {name: entry for name, entry in schema["$defs"].items() if "properties" in entry}
    order = [*_used(schema, entries)]
    sections = [_section("The document", schema)] + [_section(name, entries[name]) for name in dict.fromkeys(order)]
    return _MADE + _RESULT_HEAD + "\n".join(sections)


def _used(entry: Mapping[str, Any], entries: Mapping[str, Any]) -> Iterator[str]:
    for name in re.findall(r'"#/\$defs/(\w+)"', json.dumps(entry.get("properties", {}))):
        if name in entries:
            yield name
            yield from _used(entries[name], entries)


def _section(title: str, entry: Mapping[str, Any]) -> str:
    rows = [(f"`{key}`", _type(field), str(field.get("description", ""))) for key, field in entry["properties"].items()]
    text = re.sub(r"``(.+?)``", r"`\1`", entry.get("description", ""))
    return f"## {title}\n\n{text}\n\n{markdown_table(('key', 'type', 'meaning'), rows)}\n"


def _type(field: Mapping[str, Any]) -> str:
    """Return the type of a field in words, with links to the entries of this page."""
    if "anyOf" in field:
        return " or ".join(_type(each) for each in field["anyOf"])
    if "$ref" in field:
        name = field["$ref"].rpartition("/")[2]
        return name if name in _SHAPES else f"[{name}](#{name.lower()})"
    if "const" in field or "enum" in field:
        return ", ".join(f"`{value}`" for value in field.get("enum", [field.get("const")]))
    if field.get("type") == "array":
        inner = field.get("items") or field.get("prefixItems", [{}])[0]
        return f"list of {_type(inner)}"
    if isinstance(field.get("additionalProperties"), dict):
        return f"name -> {_type(field['additionalProperties'])}"
    return str(field.get("type", "any"))


if __name__ == "__main__":
    for name, text in generated_pages().items():
        (FOLDER / name).write_text(text, encoding="utf-8")
