# SPDX-License-Identifier: Apache-2.0
"""The fleet's page in a real browser."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import expect

from multilica.fleet.report.page import PageFailure, PageVehicle, fleet_page, store_report
from tests.fleet.support.made_store import made_store
from tests.fleet.support.requests import DAY_NS
from tests.fleet.test_report import HOSTILE, JUMP, changed, read_histories, renamed

pytestmark = [
    pytest.mark.slow,
    pytest.mark.shows("multilica/fleet", "multilica/sinks/report", "tests/fleet"),
]
LONG = "a_name_without_any_space_" * 8


@pytest.fixture(scope="module")
def pages(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("pages")
    store = made_store(folder / "store")
    creep = changed(JUMP, kind="creep", last_before_time_ns=JUMP.last_before_time_ns - 90 * DAY_NS)
    vehicle = PageVehicle("v01", 10, None, None, 8, 2, 0, 0, (), read_histories(store, "v01"))
    texts = {
        "fleet": store_report(store, folder / "fleet.html"),
        "two events": fleet_page("store", [vehicle], [JUMP, creep], []),
    }
    (history, _) = read_histories(store, "v01")
    for kind, name in (("hostile", HOSTILE), ("long", LONG)):
        vehicle = PageVehicle(name, 1, None, None, 1, 0, 1, 0, (name,), (renamed(history, name),))
        event = changed(JUMP, vehicle=name, lidars=(name,))
        failure = PageFailure(name, None, name, name, "failed", name, name, name)
        texts[kind] = fleet_page(name, [vehicle], [event], [failure])
    for name, text in texts.items():
        (folder / f"{name}.html").write_text(text, encoding="utf-8")
    return {name: folder / f"{name}.html" for name in texts}


@pytest.fixture
def show(browser, pages):
    """Opens a page; at the end nothing may have been said on the console, nor asked of any network."""
    context = browser.new_context()
    complaints: list[str] = []
    asked: list[str] = []

    def opened(name, *, width=1400, scheme="light"):
        page = context.new_page()
        page.set_viewport_size({"width": width, "height": 900})
        page.emulate_media(color_scheme=scheme)
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(pages[name].as_uri())
        return page

    yield opened
    context.close()
    assert complaints == []
    assert {*asked} <= {path.as_uri() for path in pages.values()}


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1400])
@pytest.mark.parametrize("name", ["fleet", "hostile", "long"])
def test_no_width_needs_sideways_scrolling(name, width, scheme, show):
    page = show(name, width=width, scheme=scheme)
    for unfolded in (False, True):
        if unfolded and page.get_by_role("button", name="Open all").count():
            page.get_by_role("button", name="Open all").click()
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        outside = (
            "boxes => boxes.filter(box => box.getBoundingClientRect().right > innerWidth).map(box => box.outerHTML)"
        )
        assert (
            page.locator("section, p, h1, h4, figure, .stacked td, summary, .overview tr").evaluate_all(outside) == []
        )


def test_vehicles_with_events_are_open_and_links_open_others(show):
    page = show("fleet")
    assert page.locator("details").evaluate_all("all => all.map(one => one.open)") == [True, True, False]
    page.locator(".overview").get_by_role("link", name="v03").click()
    expect(page.locator("#vehicle-3")).to_be_in_viewport()
    assert page.locator("details").evaluate_all("all => all.map(one => one.open)") == [True, True, True]
    page.locator("#vehicle-3").click()
    page.evaluate("scrollTo(0, 0)")
    page.locator(".overview").get_by_role("link", name="v03").click()  # the same link a second time
    expect(page.locator("details").nth(2).locator("svg").first).to_be_visible()
    page.get_by_role("button", name="Fold all").click()
    assert page.locator("details").evaluate_all("all => !all.some(one => one.open)")
    page.get_by_role("button", name="Open all").click()
    assert page.locator("details").evaluate_all("all => all.every(one => one.open)")


@pytest.mark.parametrize("width", [390, 1400])
@pytest.mark.parametrize("name", ["fleet", "two events"])
def test_plots_are_readable(name, width, show):
    page = show(name, width=width)
    plot = page.locator(".plot svg").first
    texts = plot.locator("text").evaluate_all(
        "all => all.map(one => { const b = one.getBoundingClientRect(); return [b.left, b.right, b.top, b.bottom]; })"
    )
    boxes = np.array(texts)
    assert (boxes[:, 3] - boxes[:, 2]).min() >= 9.0
    frame = plot.bounding_box()
    assert boxes[:, 0].min() >= frame["x"] - 1.0
    assert boxes[:, 1].max() <= frame["x"] + frame["width"] + 1.0
    crossing = [
        (one, other)
        for one in range(len(boxes))
        for other in range(one)
        if np.all(
            np.minimum(boxes[one, 1::2], boxes[other, 1::2]) - np.maximum(boxes[one, ::2], boxes[other, ::2]) > 2.0
        )
    ]
    assert crossing == []


def test_names_stay_text(show):
    page = show("hostile")
    assert page.evaluate("window.harmed") is None
    assert page.locator("img").count() == 0
    expect(page.locator("summary h3")).to_contain_text("<script>window.harmed = 1</script>")


def test_colours_follow_the_reader(show):
    colours = {
        scheme: show("fleet", scheme=scheme).evaluate("getComputedStyle(document.body).backgroundColor")
        for scheme in ("light", "dark")
    }
    brightness = {
        scheme: np.mean([int(each) for each in colour[4:-1].split(",")]) for scheme, colour in colours.items()
    }
    assert brightness["light"] > 200.0
    assert brightness["dark"] < 60.0
