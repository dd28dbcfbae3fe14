# SPDX-License-Identifier: Apache-2.0
"""A browser without a screen."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

from playwright.sync_api import Browser, sync_playwright

BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
# A root user's browser has no sandbox, a machine without a graphics card draws in software.
ARGUMENTS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


class NoBrowserError(Exception):
    """No browser is installed."""


@contextmanager
def headless_browser() -> Iterator[Browser]:
    """Start the first browser that is installed; close it at the end of the block.

    Raises:
        NoBrowserError: none is installed.
    """
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        raise NoBrowserError("no browser: apt-get install chromium-headless-shell")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found, args=[*ARGUMENTS])
        yield browser
        browser.close()
