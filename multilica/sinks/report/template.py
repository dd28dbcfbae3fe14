# SPDX-License-Identifier: Apache-2.0
"""Templates of pages that hold their style and script, and ask for nothing."""

import base64
import hashlib
import os
import sys
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemBytecodeCache, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

from multilica.errors import escape_controls


def own_text(package: str, name: str) -> str:
    """Return a text file of a package."""
    return files(package).joinpath(name).read_text(encoding="utf-8")


def page_template(
    package: str, style: str, script: str, filters: Mapping[str, Any], *, one_line: bool = False
) -> Template:
    """Load `page.html` of a package with style, script, and their hashes for the content security policy.

    With `one_line`, every text is shown in one line, with controls as escapes.
    """
    environment = Environment(
        loader=PackageLoader(package, ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_without_controls if one_line else None,
        bytecode_cache=_bytecode_cache(package),
    )
    environment.filters |= filters
    environment.globals |= {
        "style": Markup(style),  # noqa: S704
        "script": Markup(script),  # noqa: S704
        "style_hash": _hash(style),
        "script_hash": _hash(script),
    }
    return environment.get_template("page.html")


def _bytecode_cache(package: str) -> FileSystemBytecodeCache | None:
    """Keep the compiled page beside the compiled modules of its package, where these may be written."""
    folder = Path(str(files(package))) / "__pycache__"
    if sys.dont_write_bytecode or not os.access(folder, os.W_OK):
        return None
    return FileSystemBytecodeCache(str(folder), "%s.html.cache")


def _without_controls(value: object) -> object:
    return escape_controls(value) if type(value) is str else value


def _hash(text: str) -> str:
    digest = hashlib.sha256(text.encode("utf-8")).digest()
    return f"sha256-{base64.b64encode(digest).decode('ascii')}"
