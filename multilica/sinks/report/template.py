# SPDX-License-Identifier: Apache-2.0
"""Templates of pages that hold their style and script, and ask for nothing."""

import base64
import hashlib
import sys
from collections.abc import Mapping
from contextlib import suppress
from importlib.resources import files
from importlib.util import cache_from_source
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemBytecodeCache, PackageLoader, StrictUndefined, Template
from jinja2.bccache import Bucket
from markupsafe import Markup

from multilica import __version__
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
        finalize=(lambda value: escape_controls(value) if type(value) is str else value) if one_line else None,
        bytecode_cache=_CompiledTemplates(),
    )
    environment.filters |= filters
    environment.globals |= {
        "style": Markup(style),  # noqa: S704
        "script": Markup(script),  # noqa: S704
        "style_hash": _hash(style),
        "script_hash": _hash(script),
    }
    return environment.get_template("page.html")


class _CompiledTemplates(FileSystemBytecodeCache):
    """Keeps compiled templates beside the compiled modules, as Python does: only where it may write."""

    def __init__(self) -> None:
        super().__init__(str(Path(cache_from_source(__file__)).parent), f"%s.multilica-{__version__}.jinja")

    def dump_bytecode(self, bucket: Bucket) -> None:
        if not sys.dont_write_bytecode:
            with suppress(OSError):
                super().dump_bytecode(bucket)


def _hash(text: str) -> str:
    digest = hashlib.sha256(text.encode("utf-8")).digest()
    return f"sha256-{base64.b64encode(digest).decode('ascii')}"
