# SPDX-License-Identifier: Apache-2.0
"""The site: whole, without warnings, and without a request to another host."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser

import multilica
from tests.cli.support import ROOT, environment_of_process
from tests.documentation_pictures import MENU_PX

SHOWN = ("index", "quickstart", "reference/cli", "reference/python", "recording-layout")
WIDTHS = (1400, 390)
CUT = """selector => [...document.querySelectorAll('.bd-article :is(' + selector + ')')]
  .filter(each => each.scrollWidth > each.clientWidth + 1).map(each => each.innerText)"""

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
            page.evaluate("document.fonts.ready.then(() => true)")
            beyond = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
            assert beyond <= 0, f"{name} is {beyond} px too wide"
            assert page.evaluate("document.documentElement.dataset.theme") == scheme
        assert [url for url in asked if not url.startswith(("file:", "data:"))] == []
        assert any(url.endswith("site.css") for url in (each.partition("?")[0] for each in asked))


@pytest.mark.in_turn
def test_commands_and_tables_show_whole_beside_the_pages(site: Path, browser: Browser) -> None:
    with browser.new_context(viewport={"width": 1300, "height": 900}) as context:
        page = context.new_page()
        for path in sorted(site.rglob("*.html")):
            page.goto(path.as_uri())
            assert page.evaluate(CUT, "pre") == [], path.name
            assert page.evaluate(CUT, "table, .pst-scrollable-table-container") == [], path.name
            page.add_style_tag(content=".bd-article pre { white-space: pre !important; }")
            broken = {
                line[:40] for block in page.evaluate(CUT, ".highlight-console pre") for line in block.splitlines()
            }
            assert broken == set(), path.name


def test_the_contents_of_a_page_are_one_click_away(site: Path, browser: Browser) -> None:
    for width, beside in ((1300, False), (1700, True)):
        with browser.new_context(viewport={"width": width, "height": 900}) as context:
            page = context.new_page()
            page.goto((site / "cookbook.html").as_uri())
            entry = page.get_by_role("link", name="Keep accepted extrinsics in git").first
            assert entry.is_visible() is beside
            if not beside:
                page.locator("button.secondary-toggle").click()
                entry.wait_for(state="visible")


def test_the_first_picture_warns_of_nothing() -> None:
    """The viewer's menu warns, in orange, of a machine without a graphics card and of a container."""
    picture = Image.open(ROOT / "docs" / "pictures" / "result.png").convert("RGB")
    menu = np.asarray(picture.crop((0, 0, picture.width // 2, 40)), dtype=int)
    assert picture.size == (1280, 720 - MENU_PX)
    warning = (menu[..., 0] > 200) & (menu[..., 1] < 150) & (menu[..., 2] < 80)
    assert int(warning.sum()) == 0
