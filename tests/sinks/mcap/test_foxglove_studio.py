# SPDX-License-Identifier: Apache-2.0
"""result.mcap in Foxglove Studio 1.48, the newest that a package registry has."""

from __future__ import annotations

import io
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from PIL import Image
from playwright.sync_api import Browser, Page, expect

from multilica.sinks.drawing.palette import Rgb, distinct_colours
from multilica.sinks.mcap.result_mcap import ResultMcap
from tests.ingest.support.processes import served
from tests.sinks.made_events import LIDARS, UNPLACED, made_events

STUDIO = Path(__file__).parent / "foxglove_studio"
NODE_MODULES = Path(__file__).parents[2] / "node" / "node_modules"
pytestmark = [
    pytest.mark.xdist_group("browser"),
    pytest.mark.skipif(
        not (NODE_MODULES / "@foxglove").is_dir(), reason="run: npm install --prefix tests/node --no-package-lock"
    ),
]
WINDOW = {"width": 1400, "height": 800}
LOADED_MS = 120_000
DRAWN_S = 60.0
MIN_PIXELS = 30


@dataclass
class Studio:
    page: Page
    complaints: list[str] = field(default_factory=list)

    def hear(self, kind: str, text: str) -> None:
        if kind == "error":
            self.complaints.append(text)

    def pixels_of(self, colour: Rgb) -> int:
        """Count the pixels of a colour, up to the rounding of drivers."""
        picture = self.page.locator("canvas").first.screenshot()
        pixels = np.asarray(Image.open(io.BytesIO(picture)).convert("RGB"), dtype=np.int64)
        return int((np.abs(pixels - np.array(colour)).max(axis=2) <= 4).sum())


@pytest.fixture
def open_studio(browser: Browser, tmp_path: Path) -> Iterator[Callable[[], Studio]]:
    """Opens the result.mcap of the test's folder, with the layout that is attached to it."""
    (tmp_path / "node_modules").symlink_to(NODE_MODULES)
    shutil.copytree(STUDIO, tmp_path, dirs_exist_ok=True)
    with served("file_server.py", tmp_path) as port, browser.new_context(viewport=WINDOW) as context:
        site = f"http://127.0.0.1:{port}/files/"
        context.route(lambda url: not url.startswith(site), lambda route: route.abort())

        def show() -> Studio:
            with (tmp_path / "result.mcap").open("rb") as file:
                attachments = {one.name: one.data for one in make_reader(file).iter_attachments()}
            (tmp_path / "layout.json").write_bytes(attachments["foxglove-layout.json"])
            studio = Studio(context.new_page())
            studio.page.on("console", lambda message: studio.hear(message.type, message.text))
            studio.page.on("pageerror", lambda error: studio.hear("error", str(error)))
            studio.page.goto(f"{site}index.html", timeout=LOADED_MS)
            return studio

        yield show


@pytest.mark.parametrize("outcome", ["complete", "partial"])
@pytest.mark.parametrize("encoding", ["foxglove", "ros2"])
def test_placed_clouds_are_drawn_without_a_problem(tmp_path, open_studio, encoding, outcome):
    with ResultMcap(tmp_path / "result.mcap", encoding) as observe:
        for event in made_events(outcome):
            observe(event)
    studio = open_studio()
    expect(studio.page.get_by_text(f'"{outcome}"').first).to_be_visible(timeout=LOADED_MS)
    colours = distinct_colours(LIDARS)
    placed = [name for name in LIDARS if outcome == "complete" or name != UNPLACED]
    deadline = time.monotonic() + DRAWN_S
    while not all(studio.pixels_of(colours[name]) > MIN_PIXELS for name in placed):
        assert time.monotonic() < deadline, {name: studio.pixels_of(colours[name]) for name in LIDARS}
        studio.page.wait_for_timeout(500)
    assert studio.complaints == []
