# SPDX-License-Identifier: Apache-2.0
"""Buttons of the page: texts to copy, pictures to enlarge."""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.sync_api import expect

from multilica.exports.files import rig_of_run
from multilica.exports.formats import FORMATS
from multilica.sinks.files.result_files import calibration_toml
from multilica.sinks.report.page import extrinsics_texts
from tests.selection import RUN_FILES
from tests.sinks.report.conftest import made_contents, with_name, with_values

pytestmark = [pytest.mark.slow, pytest.mark.shows(*RUN_FILES)]

NO_CLIPBOARD = """Object.defineProperty(navigator, "clipboard", { value: undefined });
document.addEventListener("copy", () => { window.copied = document.activeElement.value; });"""
KEEPS_TEXT = """Object.defineProperty(navigator, "clipboard",
  { value: { writeText: async (text) => { window.copied = text; } } });"""
REFUSES = "document.execCommand = () => false; Object.defineProperty(navigator, 'clipboard', { value: undefined });"


def expected_texts(document) -> dict[str, str]:
    """The file of the run, and what `multilica export` writes."""
    rig, _ = rig_of_run(document)
    exported = {
        label: FORMATS[name].content(rig, Path(path)).decode()
        for label, name, path in (("URDF", "urdf", "a.urdf"), ("matrices", "matrices", "a.txt"))
    }
    return {"TOML": calibration_toml(document), **exported}


def test_texts_are_those_of_the_exporters():
    for outcome in ("complete", "partial", "uncertain"):
        document = made_contents(outcome).document
        assert {one.label: one.text for one in extrinsics_texts(document)} == expected_texts(document)


def test_poses_are_in_the_base_frame_that_an_export_takes():
    contents = made_contents("complete")
    ground = contents.document.ground.model_dump(mode="json")
    on_rig = ground | {"T_base_target_rig": ground["T_base_target"]}
    document = with_values(contents, ground=on_rig).document
    texts = {one.label: one.text for one in extrinsics_texts(document)}
    assert texts == expected_texts(document)
    assert '<parent link="base" />' in texts["URDF"]
    doubted = with_values(contents, ground=on_rig | {"doubt": "too little ground"}).document
    assert '<parent link="top" />' in {one.label: one.text for one in extrinsics_texts(doubted)}["URDF"]


def test_without_a_placed_lidar_there_is_nothing_to_copy():
    assert extrinsics_texts(made_contents("failed").document) == []


def test_names_that_files_cannot_have_leave_the_table_alone():
    document = with_name(made_contents("complete"), "front left/1", "front\nleft").document
    assert [one.label for one in extrinsics_texts(document)] == ["TOML"]


@pytest.mark.parametrize("before", [KEEPS_TEXT, NO_CLIPBOARD], ids=["clipboard", "selection"])
def test_buttons_copy_what_their_label_says(before, open_report):
    page = open_report("complete", before=before)
    for label, text in expected_texts(made_contents("complete").document).items():
        button = page.get_by_role("button", name=label, exact=True)
        button.focus()
        page.keyboard.press("Enter")
        expect(page.locator("#copy [role=status]")).to_contain_text("Copied")
        assert page.evaluate("window.copied") == text
        expect(button).to_be_focused()


def test_a_text_that_cannot_be_copied_is_selected(open_report):
    page = open_report("complete", before=REFUSES)
    page.get_by_role("button", name="URDF", exact=True).click()
    expect(page.locator("#copy [role=status]")).to_contain_text("Press Ctrl+C")
    area = page.locator("#copy textarea:visible")
    expect(area).to_be_focused()
    assert area.evaluate("(element) => element.selectionEnd - element.selectionStart === element.value.length")


def test_a_picture_fills_the_window_and_closes_again(open_report):
    page = open_report("complete")
    first = page.locator("button.enlarge").first
    first.focus()
    page.keyboard.press("Enter")
    enlarged = page.locator("dialog.enlarged img")
    expect(enlarged).to_be_visible()
    assert enlarged.bounding_box()["width"] >= 1600
    page.keyboard.press("Escape")
    expect(enlarged).to_be_hidden()
    expect(first).to_be_focused()
