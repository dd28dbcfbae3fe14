# SPDX-License-Identifier: Apache-2.0
"""The site: whole, without warnings, and without a request to another host."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from playwright.sync_api import Browser

import multilica
from tests.cli.support import ROOT, environment_of_process

SHOWN = ("index", "quickstart", "reference/cli", "reference/python", "recording-layout")
WIDTHS = (1400, 390)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.shows("docs", "multilica", "cli", *(path.name for path in ROOT.glob("*.md"))),
]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site as `make site` builds it."""
    recipe = re.search(r"\$\(BIN\)/sphinx-build (.+) build/site\n", (ROOT / "Makefile").read_text(encoding="utf-8"))
    assert recipe is not None
    assert {"-W", "-n"} <= {*recipe[1].split()}
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", *recipe[1].split(), str(folder)]
    built = subprocess.run(command, cwd=ROOT, env=environment_of_process(), capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    return folder


def test_every_page_is_on_the_site(site: Path) -> None:
    pages = {path.relative_to(ROOT / "docs").with_suffix(".html") for path in ROOT.glob("docs/**/*.md")}
    assert [page for page in sorted(pages) if not (site / page).is_file()] == []


def test_every_public_name_is_described(site: Path) -> None:
    page = (site / "reference" / "python.html").read_text(encoding="utf-8")
    names = {name for name in multilica.__all__ if not name.startswith("__")}
    assert sorted(name for name in names if f'id="multilica.{name}"' not in page) == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", WIDTHS)
def test_pages_ask_no_host_and_fit_the_screen(site: Path, browser: Browser, width: int, scheme: str) -> None:
    with browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme) as context:
        page = context.new_page()
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        for name in SHOWN:
            page.goto((site / f"{name}.html").as_uri())
            page.wait_for_load_state("networkidle")
            beyond = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
            assert beyond <= 0, f"{name} is {beyond} px too wide"
            assert page.evaluate("document.documentElement.dataset.theme") == scheme
        assert [url for url in asked if not url.startswith(("file:", "data:"))] == []
        assert any(url.endswith("site.css") for url in (each.partition("?")[0] for each in asked))
