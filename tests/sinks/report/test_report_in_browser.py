# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser."""

from __future__ import annotations

import io
import re

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page, expect

from tests.selection import RUN_FILES

pytestmark = [pytest.mark.slow, pytest.mark.shows(*RUN_FILES)]
IS_PAINTED = "(element) => element.checkVisibility({ contentVisibilityAuto: true })"
NO_WEBGL = "HTMLCanvasElement.prototype.getContext = () => null;"


def pixels(page: Page, selector: str = "canvas") -> np.ndarray:
    # Two frames: what an event asked for is drawn in the next one.
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return np.asarray(Image.open(io.BytesIO(page.locator(selector).screenshot())).convert("RGB"), dtype=np.int64)


def changed_share(before: np.ndarray, after: np.ndarray) -> float:
    return float((np.abs(before - after).max(axis=2) > 8).mean())


def drag(page: Page, right: int, down: int) -> None:
    box = page.locator("canvas").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + right, y + down, steps=3)
    page.mouse.up()


@pytest.mark.parametrize("name", ["failed", "stopped", "ended early"])
def test_a_run_without_a_result_shows_headline_and_clouds(name, open_report):
    page = open_report(name)
    expect(page.locator("#rig-view")).to_have_attribute("data-state", "ready")
    expect(page.locator("h1")).to_be_in_viewport()
    colours = np.unique(pixels(page).reshape(-1, 3), axis=0)
    assert len(colours) > 20  # points, not an empty stage


def test_the_view_is_turned_by_mouse_and_keys_and_comes_home(open_report):
    page = open_report("complete")
    page.locator("canvas").scroll_into_view_if_needed()
    home = pixels(page)
    drag(page, 150, 40)
    turned = pixels(page)
    assert changed_share(home, turned) > 0.01
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("+")
    keyed = pixels(page)
    assert changed_share(turned, keyed) > 0.01
    page.mouse.wheel(0, 400)
    assert changed_share(keyed, pixels(page)) > 0.01
    page.keyboard.press("Home")
    assert changed_share(home, pixels(page)) < 0.001


def test_two_fingers_zoom(open_report):
    page = open_report("complete")
    page.locator("canvas").scroll_into_view_if_needed()
    before = pixels(page)
    page.evaluate(
        """() => {
          const canvas = document.querySelector("canvas");
          canvas.setPointerCapture = () => {}; // made-up fingers cannot be captured
          const touch = (type, pointerId, clientX) => canvas.dispatchEvent(
            new PointerEvent(type, { pointerId, clientX, clientY: 200, pointerType: "touch", bubbles: true }));
          touch("pointerdown", 11, 300);
          touch("pointerdown", 12, 400);
          touch("pointermove", 12, 600);
        }"""
    )
    assert changed_share(before, pixels(page)) > 0.01


def test_a_lidar_can_be_hidden_and_the_recorded_frames_shown(open_report):
    page = open_report("complete")
    both = pixels(page)
    page.get_by_role("checkbox", name="rear").uncheck()
    hidden = pixels(page)
    assert changed_share(both, hidden) > 0.001
    page.get_by_role("radio", name="as recorded").check()
    assert changed_share(hidden, pixels(page)) > 0.01


def test_a_refused_pose_is_there_to_be_looked_at(open_report):
    page = open_report("partial")
    box = page.get_by_role("checkbox", name="rear refused pose")
    expect(box).not_to_be_checked()
    before = pixels(page)
    box.check()
    assert changed_share(before, pixels(page)) > 0.001


def test_a_failure_is_told_on_the_first_screen(open_report):
    page = open_report("partial")
    page.set_viewport_size({"width": 1280, "height": 720})
    expect(page.locator("h1")).to_have_text(
        "1 of 3 LiDARs is not placed. rear: it shares too few surfaces with the others (no overlap)."
    )
    for words in ("Step", "Against", "Decisive", "What helps"):
        expect(page.locator("dt", has_text=words)).to_be_in_viewport()
    expect(page.locator("article img").first).to_be_in_viewport()


def test_a_name_cannot_leave_the_text(open_report):
    page = open_report("hostile")
    expect(page.locator("#rig-view")).to_have_attribute("data-state", "ready")
    expect(page.locator("h1")).to_contain_text("<script>window.harmed = 1</script>")
    assert page.evaluate("window.harmed") is None
    assert page.locator("img[src=x]").count() == 0


def test_without_webgl_the_page_says_so(open_report):
    page = open_report("complete", before=NO_WEBGL)
    expect(page.locator(".fallback")).to_be_visible()
    expect(page.locator(".still")).to_be_visible()
    expect(page.locator(".controls")).to_be_hidden()


def test_dark_and_light_follow_the_reader(open_report):
    def brightness(scheme: str) -> float:
        return float(np.median(pixels(open_report("complete", scheme=scheme), "header")))

    assert brightness("light") > 200.0
    assert brightness("dark") < 60.0


def test_it_prints_on_white_with_pictures_and_configuration(open_report):
    page = open_report("partial")
    assert page.locator("pre").evaluate(IS_PAINTED) is False
    expect(page.locator(".still")).to_be_hidden()
    page.emulate_media(media="print", color_scheme="dark")
    for hidden in (".controls", "canvas", "#copy"):
        expect(page.locator(hidden)).to_be_hidden()
    expect(page.locator(".still")).to_be_visible()
    assert (pixels(page, "header")[0, 0] == 255).all()
    assert np.median(pixels(page, ".still")) > 245  # the ground of a picture is white on paper
    assert page.locator("pre").evaluate(IS_PAINTED) is True
    printed = page.pdf(format="A4", print_background=True)
    assert printed.startswith(b"%PDF")
    assert len(re.findall(rb"/Type\s*/Page\b", printed)) >= 3
    assert len(re.findall(rb"/Subtype\s*/Image", printed)) >= 5
