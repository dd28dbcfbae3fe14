# SPDX-License-Identifier: Apache-2.0
"""Reports of made-up runs, written once."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page

from multilica.results.document import ResultDocument
from multilica.sinks.report.contents import ReportContents, contents_of
from multilica.sinks.report.page import ReportFile, report_html
from multilica.sinks.run_state import RunState
from tests.sinks.made_events import made_events

HOSTILE = "</script><script>window.harmed = 1</script><img src=x onerror='window.harmed = 2'>"
"""A name that tries to leave the text."""
LONG = "lidar_points_with_a_name_that_has_no_space_" * 3
STOPPED = "Stopped by SIGTERM."


def made_contents(outcome: str, **settings) -> ReportContents:
    state = RunState()
    for event in made_events(outcome, **settings):
        state(event)
    return contents_of(state)


def with_values(contents: ReportContents, **values: object) -> ReportContents:
    """The same run with other parts of its document, given as plain values."""
    document = contents.document.model_dump(mode="json") | values
    return replace(contents, document=ResultDocument.model_validate(document))


def with_name(contents: ReportContents, lidar: str, name: str) -> ReportContents:
    """The same run, had a LiDAR borne another name."""
    document = json.loads(contents.document.model_dump_json().replace(lidar, json.dumps(name)[1:-1]))
    document["input"]["notes"] = [name]
    clouds = {name if each == lidar else each: cloud for each, cloud in contents.clouds.items()}
    return ReportContents(ResultDocument.model_validate(document), clouds)


def ended_early(directory: Path) -> None:
    with ReportFile(directory) as report:
        for event in list(made_events())[:12]:
            report(event)
        raise KeyboardInterrupt(STOPPED)


@pytest.fixture(scope="session")
def reports(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A page per kind of outcome."""
    folder = tmp_path_factory.mktemp("reports")
    pages = {outcome: made_contents(outcome) for outcome in ("complete", "partial", "uncertain", "failed")}
    pages["stopped"] = made_contents("complete", until="coarse")
    pages["hostile"] = with_name(pages["partial"], "rear", HOSTILE)
    pages["long names"] = with_name(pages["uncertain"], "rear", LONG)
    for name, contents in pages.items():
        (folder / f"{name}.html").write_text(report_html(contents), encoding="utf-8")
    with pytest.raises(KeyboardInterrupt):
        ended_early(folder)
    (folder / "report.html").rename(folder / "ended early.html")
    return {path.stem: path for path in folder.iterdir()}


@pytest.fixture
def open_report(browser: Browser, reports: dict[str, Path]) -> Iterator[Callable[..., Page]]:
    """Opens a report; at the end nothing may have been said on the console, nor asked of any network."""
    context = browser.new_context(viewport={"width": 900, "height": 560})
    complaints: list[str] = []
    asked: list[str] = []

    def show(name: str, *, scheme: str = "light", before: str = "") -> Page:
        page = context.new_page()
        page.emulate_media(color_scheme=scheme)
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.add_init_script(before)
        page.goto(reports[name].as_uri())
        return page

    yield show
    context.close()
    assert complaints == []
    opened = {path.as_uri() for path in reports.values()}
    assert [url for url in asked if url not in opened and not url.startswith("data:")] == []
