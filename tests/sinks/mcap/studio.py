# SPDX-License-Identifier: Apache-2.0
"""Foxglove Studio 1.48, the newest that a package registry has, in a browser."""

from __future__ import annotations

import io
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from PIL import Image
from playwright.sync_api import Browser, Page, expect

from multilica.sinks.drawing import Rgb
from tests.ingest.support.processes import served

STUDIO = Path(__file__).parent / "foxglove_studio"
NODE_MODULES = Path(__file__).parents[2] / "node" / "node_modules"
WINDOW = {"width": 1400, "height": 800}
LOADED_MS = 120_000


@dataclass
class Studio:
    page: Page
    complaints: list[str] = field(default_factory=list)

    def hear(self, kind: str, text: str) -> None:
        if kind == "error":
            self.complaints.append(text)

    def await_metrics(self, status: str) -> None:
        """Wait until the panel of metrics shows the status of the run."""
        expect(self.page.get_by_text(f'"{status}"').first).to_be_visible(timeout=LOADED_MS)

    def pixels_of(self, colour: Rgb) -> int:
        """Count the pixels of a colour, up to the rounding of drivers."""
        picture = self.page.locator("canvas").first.screenshot()
        pixels = np.asarray(Image.open(io.BytesIO(picture)).convert("RGB"), dtype=np.int64)
        return int((np.abs(pixels - np.array(colour)).max(axis=2) <= 4).sum())


def has_studio() -> bool:
    return (NODE_MODULES / "@foxglove").is_dir()


@contextmanager
def served_studio(browser: Browser, folder: Path) -> Iterator[Callable[[], Studio]]:
    """Opens the result.mcap of the folder, with the layout that is attached to it."""
    (folder / "node_modules").symlink_to(NODE_MODULES)
    shutil.copytree(STUDIO, folder, dirs_exist_ok=True)
    with served("file_server.py", folder) as port, browser.new_context(viewport=WINDOW) as context:
        site = f"http://127.0.0.1:{port}/files/"
        context.route(lambda url: not url.startswith(site), lambda route: route.abort())

        def show() -> Studio:
            with (folder / "result.mcap").open("rb") as file:
                attachments = {one.name: one.data for one in make_reader(file).iter_attachments()}
            (folder / "layout.json").write_bytes(attachments["foxglove-layout.json"])
            studio = Studio(context.new_page())
            studio.page.on("console", lambda message: studio.hear(message.type, message.text))
            studio.page.on("pageerror", lambda error: studio.hear("error", str(error)))
            studio.page.goto(f"{site}index.html", timeout=LOADED_MS)
            return studio

        yield show
