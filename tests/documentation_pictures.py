# SPDX-License-Identifier: Apache-2.0
"""Makes the pictures of the documentation, and checks the output that the pages quote.

A section of docs/failures.md with pictures names its scene; the sample gives the others.
"""

from __future__ import annotations

import io
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, expect

from tests.sinks.browser import headless_browser
from tests.sinks.mcap.studio import has_studio, served_studio

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "pictures"
FAILURES = (ROOT / "docs" / "failures.md").read_text(encoding="utf-8")
SAMPLE = ROOT / "recordings" / "samples" / "edgar-street.mcap"
SHORT = ("--frames", "2", "--keep-every", "4")
SIZE = ("--width", "1280", "--height", "720")
MENU_PX = 36
"""Height of the viewer's menu, which warns of the machine that draws."""
SCREEN = {"width": 1100, "height": 720}
FLEET_SCREEN = {"width": 1100, "height": 640}
TALL_SCREEN = {"width": 1100, "height": 1370}
SETTLED_MS = 5_000
ENDED = (0, 3, 4)  # done, refused, incomplete


@dataclass(frozen=True)
class Scene:
    """A scene of docs/failures.md, under the name of its pictures."""

    name: str
    simulate: tuple[str, ...]
    prior: str
    drawing: str


def scenes() -> Iterator[Scene]:
    for section in FAILURES.split("\n## ")[1:]:
        picture = re.search(r"\(pictures/(.+)\.png\)", section)
        named = re.search(r"Rig `(.+?)`, scene `(.+?)`, seed (\d+)(?:, `--disturb (.+?)`)?", section)
        if picture is None or named is None:
            continue
        options = zip(("--rig", "--scene", "--seed", "--disturb"), named.groups(), strict=True)
        prior = re.search(r"`--prior (.+?)`", section)
        drawing = re.search(r"^```toml\n(.*?)^```", section, re.MULTILINE | re.DOTALL)
        yield Scene(
            picture[1],
            tuple(text for option, value in options if value for text in (option, value)),
            prior[1] if prior else "",
            drawing[1] if drawing else "",
        )


def quotes() -> list[str]:
    """The lines of output that the pages show."""
    found = re.findall(r"^> .*(?:\n> .*)*", FAILURES, re.MULTILINE)
    page = (ROOT / "docs" / "quickstart.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```(\w*)\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    found += [block for language, block in blocks if not language]
    return [line for quote in found for line in re.sub(r"\n> |^> ", " ", quote).replace("<br>", "\n").splitlines()]


def run(folder: Path, *arguments: str) -> str:
    """Run the command line in a folder; return what it prints."""
    command = [sys.executable, "-m", "multilica_cli", *arguments]
    done = subprocess.run(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    if done.returncode not in ENDED:
        sys.exit(f"{' '.join(arguments)} ended with {done.returncode}: {done.stdout}")
    return done.stdout


def calibrate(folder: Path, scene: Scene) -> str:
    recording = f"{scene.name}.mcap"
    run(folder, "simulate", *scene.simulate, *SHORT, "--out", recording)
    if scene.prior:
        (folder / scene.prior).write_text(scene.drawing, encoding="utf-8")
    prior = ("--prior", scene.prior) if scene.prior else ()
    return run(folder, "calibrate", recording, *prior, "--out", scene.name)


def save(picture: bytes, name: str, *, without_top_px: int = 0) -> None:
    """Write a picture with 256 colours."""
    colours = Image.open(io.BytesIO(picture)).convert("RGB")
    colours = colours.crop((0, without_top_px, *colours.size))
    path = PICTURES / f"{name}.png"
    palette = colours.quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=1, dither=Image.Dither.NONE)
    palette.save(path, optimize=True)
    print(f"{path.relative_to(ROOT)} {path.stat().st_size / 1000:.0f} kB", flush=True)


def draw_recording(folder: Path, name: str) -> None:
    run(folder, "view", name, "--png", f"{name}.png", *SIZE)
    save((folder / f"{name}.png").read_bytes(), name, without_top_px=MENU_PX)


def draw_report(browser: Browser, directory: Path, name: str, screen: dict[str, int]) -> None:
    with browser.new_context(viewport=screen) as context:
        page = context.new_page()
        page.goto((directory / "report.html").as_uri())
        expect(page.locator("#rig-view")).to_have_attribute("data-state", "ready")
        save(page.screenshot(), name)


def draw_fleet(browser: Browser, folder: Path) -> None:
    """Draw the fleet's page: the events, and the poses of a LiDAR that jumped."""
    run(folder, "simulate", "--fleet", "logs")
    run(folder, "fleet", "run", "logs", "--out", "store", "-q")
    run(folder, "fleet", "report", "--store", "store", "--out", "fleet.html")
    draw_fleet_page(browser, folder / "fleet.html")


def draw_fleet_page(browser: Browser, page_file: Path) -> None:
    with browser.new_context(viewport=FLEET_SCREEN) as context:
        page = context.new_page()
        page.goto(page_file.as_uri())
        save(page.screenshot(), "fleet-events")
        page.locator("details[open]").first.scroll_into_view_if_needed()
        box = page.locator("details[open]").first.bounding_box()
        page.evaluate("offset => window.scrollBy(0, offset)", box["y"] - 20)
        page.wait_for_timeout(500)
        save(page.screenshot(), "fleet-drift")


def draw_studio(browser: Browser, result_mcap: Path) -> None:
    """Draw the result.mcap in Foxglove Studio without its hint for beginners, the log at its end."""
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(result_mcap, folder)
        with served_studio(browser, Path(folder)) as open_studio:
            studio = open_studio()
            studio.await_metrics("complete")
            page = studio.page
            page.get_by_role("button", name="Dismiss", exact=True).click()
            page.get_by_text("[multilica]").first.hover()
            page.mouse.wheel(0, 1)  # else the button is not there
            page.get_by_title("Scroll to bottom").click()
            expect(page.get_by_text("calibration complete")).to_be_visible()
            page.wait_for_timeout(SETTLED_MS)
            save(page.screenshot(), "foxglove")


def main() -> int:
    """Make all pictures; fail if a page quotes a line that no command printed."""
    with tempfile.TemporaryDirectory() as temporary, headless_browser() as browser:
        folder = Path(temporary)
        printed = run(ROOT, "calibrate", str(SAMPLE.relative_to(ROOT)), "--out", str(folder / "result"))
        draw_recording(folder, "result")
        draw_report(browser, folder / "result", "report", TALL_SCREEN)
        if has_studio():
            draw_studio(browser, folder / "result" / "result.mcap")
        else:
            print("foxglove.png is left as it is: Foxglove Studio is missing (make node)")
        draw_fleet(browser, folder)
        for scene in scenes():
            printed += calibrate(folder, scene)
            draw_recording(folder, scene.name)
            draw_report(browser, folder / scene.name, f"{scene.name}-report", SCREEN)
    words = " ".join(printed.split())
    untrue = [line for line in quotes() if " ".join(line.split()) not in words]
    for line in untrue:
        print(f"no command printed: {line}")
    return int(bool(untrue))


if __name__ == "__main__":
    sys.exit(main())
