# SPDX-License-Identifier: Apache-2.0
"""The page on a phone, a tablet and a screen, dark and light."""

from __future__ import annotations

import pytest

from tests.selection import RUN_FILES

pytestmark = [pytest.mark.slow, pytest.mark.shows(*RUN_FILES)]

WIDTHS = (390, 800, 1400)
REPORTS = ("complete", "partial", "uncertain", "failed", "long names")

CUT_OFF = """() => [...document.querySelectorAll("body *")].filter((element) => {
  const box = element.getBoundingClientRect();
  return box.width > 0 && !element.closest("svg, .scroll, .labels, pre, dialog")
    && (box.right > document.documentElement.clientWidth + 1 || box.left < -1);
}).map((element) => `${element.tagName}: ${element.textContent.slice(0, 60)}`)"""

COVERED = """() => {
  const found = [];
  for (const svg of document.querySelectorAll("svg.rig")) {
    const frame = svg.getBoundingClientRect();
    const texts = [...svg.querySelectorAll("text")].map((text) => [text.textContent, text.getBoundingClientRect()]);
    texts.forEach(([text, box], index) => {
      if (box.left < frame.left || box.right > frame.right || box.top < frame.top || box.bottom > frame.bottom)
        found.push(`${text} leaves the drawing`);
      for (const [other, its] of texts.slice(index + 1))
        if (Math.min(box.right, its.right) - Math.max(box.left, its.left) > 1
            && Math.min(box.bottom, its.bottom) - Math.max(box.top, its.top) > 4)
          found.push(`${text} covers ${other}`);
    });
  }
  return found;
}"""

# WCAG 2: contrast of every text on the page with the nearest colour behind it.
FAINT = """() => {
  const channels = (colour) => colour.match(/[\\d.]+/g).map(Number);
  const luminance = (colour) => channels(colour).slice(0, 3)
    .map((value) => value / 255).map((value) => value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4)
    .reduce((sum, value, index) => sum + value * [0.2126, 0.7152, 0.0722][index], 0);
  const behind = (element) => {
    for (let each = element; each; each = each.parentElement) {
      const colour = getComputedStyle(each).backgroundColor;
      if ((channels(colour)[3] ?? 1) > 0) return colour;
    }
    return "rgb(255, 255, 255)";
  };
  const texts = [...document.querySelectorAll("body *")].filter((element) =>
    !element.closest("svg, script, textarea, .labels") && element.checkVisibility()
    && [...element.childNodes].some((node) => node.nodeType === Node.TEXT_NODE && node.textContent.trim()));
  return texts.map((element) => {
    const [a, b] = [luminance(getComputedStyle(element).color), luminance(behind(element))].sort((x, y) => x - y);
    return [(b + 0.05) / (a + 0.05), element.textContent.trim().slice(0, 40)];
  }).filter(([contrast]) => contrast < 4.5);
}"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", REPORTS)
def test_everything_is_within_the_page(name, scheme, open_report):
    page = open_report(name, scheme=scheme)
    for width in WIDTHS:
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.evaluate(CUT_OFF) == []
        assert page.evaluate(COVERED) == []
    assert page.evaluate(FAINT) == []


@pytest.mark.parametrize("width", WIDTHS)
def test_the_formula_stays_on_one_line(width, open_report):
    page = open_report("complete")
    page.set_viewport_size({"width": width, "height": 900})
    formula = page.locator(".formula")
    assert formula.inner_text() == "p_target = T_target_source @ p_source"
    assert formula.evaluate("(element) => element.scrollWidth <= element.clientWidth")
    assert formula.evaluate("(element) => element.clientHeight / parseFloat(getComputedStyle(element).fontSize)") < 2.0


def test_pictures_take_the_width_of_a_screen(open_report):
    page = open_report("complete")
    page.set_viewport_size({"width": 1400, "height": 900})
    widths = page.locator(".pictures.wide img").evaluate_all("(images) => images.map((image) => image.clientWidth)")
    assert len(widths) == 4
    assert min(widths) > 1200
