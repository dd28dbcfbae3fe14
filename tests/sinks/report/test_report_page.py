# SPDX-License-Identifier: Apache-2.0
"""The page as text: complete by itself, small, the same each time."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from importlib.resources import files
from itertools import pairwise

import numpy as np
import pytest

from multilica.sinks.report import page
from multilica.sinks.report.contents import ReportContents
from multilica.sinks.report.page import report_html
from tests.sinks.report.conftest import HOSTILE, made_contents, with_name, with_values


class Outline(HTMLParser):
    """The elements of a page with their attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attributes)))

    def all(self, *tags: str) -> list[dict[str, str | None]]:
        return [attributes for tag, attributes in self.elements if tag in tags]


@pytest.fixture(scope="module")
def partial() -> ReportContents:
    return made_contents("partial")


@pytest.fixture(scope="module")
def text(partial: ReportContents) -> str:
    return report_html(partial)


def test_it_refers_to_nothing_outside_itself(text):
    outline = Outline(text)
    addresses = [one[key] for _, one in outline.elements for key in ("src", "href", "srcset", "action") if key in one]
    assert addresses
    assert [address for address in addresses if not address.startswith("data:image/png;base64,")] == []
    assert outline.all("link", "iframe", "object", "base", "form") == []
    assert re.findall(r"url\(|@import", text) == []


def test_the_same_run_makes_the_same_page(partial, text):
    assert report_html(partial) == text


def test_it_can_be_read_without_seeing_it(text):
    outline = Outline(text)
    pictures = outline.all("img")
    assert len(pictures) == 7
    assert all(len(picture["alt"]) > 20 for picture in pictures)
    levels = [int(tag[1]) for tag, _ in outline.elements if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after - before <= 1 for before, after in pairwise(levels))
    labelled = {one["aria-labelledby"] for one in outline.all("section")}
    assert labelled == {one["id"] for one in outline.all("h2")}
    assert all("scope" in one for one in outline.all("th"))


def test_nothing_styles_or_scripts_itself_past_the_policy(text):
    outline = Outline(text)
    assert [one for _, one in outline.elements if "style" in one or any(key.startswith("on") for key in one)] == []
    (policy,) = (one["content"] for one in outline.all("meta") if one.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none'")
    assert "unsafe" not in policy


def test_a_hostile_name_stays_a_name(partial):
    text = report_html(with_name(partial, "rear", HOSTILE))
    outline = Outline(text)
    assert [one for one in outline.all("img") if not one["src"].startswith("data:")] == []
    assert len(outline.all("script")) == 2
    assert "window.harmed" in text
    assert HOSTILE not in text


def test_everything_that_was_found_is_on_it(partial, text):
    words = re.sub(r"<[^>]+>", " ", text)
    for lidar, entry in partial.document.lidars.items():
        assert lidar in words
        for value in entry.xyz_m or ():
            assert f"{value:z.3f}" in words
    for pair in partial.document.pairs:
        for reason in pair.verdict.reasons:
            assert reason.text in words
    assert partial.document.input.sha256 in words
    assert partial.notes[0] in words
    assert "max_iterations" in words
    assert f"numpy {np.__version__}" in words


def test_large_clouds_are_thinned_until_the_page_fits(partial, monkeypatch):
    large = {name: np.random.default_rng(1).uniform(-20.0, 20.0, (40_000, 3)) for name in partial.document.lidars}
    contents = ReportContents(partial.document, large)
    with monkeypatch.context() as thinned:
        thinned.setattr(page, "MAX_POINTS", 0)
        without = len(report_html(contents))
    monkeypatch.setattr(page, "MAX_BYTES", without + 500_000)
    text = report_html(contents)
    assert without < len(text.encode()) <= page.MAX_BYTES
    (shown,) = re.findall(r"Thinned at random to ([\d,]+) of 120,000 points", text)
    assert 0 < int(shown.replace(",", "")) < 120_000


def colours(scheme: str) -> dict[str, str]:
    """The named colours of the style in one scheme."""
    style = files("multilica.sinks.report").joinpath("page.css").read_text(encoding="utf-8")
    light, dark = style.split("@media (prefers-color-scheme: dark)")[:2]
    found = dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", light))
    return (
        found if scheme == "light" else found | dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", dark.split("\n}\n")[0]))
    )


def luminance(colour: str) -> float:
    """Relative luminance as WCAG 2 defines it."""
    channels = np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)]) / 255.0
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize(
    ("text", "ground"),
    [(text, ground) for text in ("text", "soft", "good", "doubt", "bad") for ground in ("page", "card")]
    + [("good", "good-tint"), ("doubt", "doubt-tint"), ("bad", "bad-tint"), ("on-picture", "picture")],
)
def test_text_stands_out_from_its_ground(scheme, text, ground):
    named = colours(scheme)
    dim, bright = sorted((luminance(named[text]), luminance(named[ground])))
    assert (bright + 0.05) / (dim + 0.05) >= 4.5


def test_commands_in_advice_are_set_as_code_and_nothing_else_is(partial: ReportContents) -> None:
    refusal = {"code": "unfit_input", "text": "<b>empty</b>.mcap has `nothing`."}
    text = report_html(with_values(partial, refusal=refusal))
    assert "as <code>multilica inspect</code> shows</li>" in text
    assert "&lt;b&gt;empty&lt;/b&gt;.mcap has `nothing`." in text
