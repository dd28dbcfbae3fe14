# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import pytest
from defusedxml import ElementTree
from lxml import etree
from PIL import Image

from multilica.checks import check_document
from multilica.checks.ci_reports import (
    check_png,
    code_quality_json,
    github_annotations,
    junit_xml,
    summary_markdown,
    write_reports,
)
from tests.checks.test_comparison import SHIFT, checked, run_with

TIME = "2026-11-23T03:00:00"
SCHEMA = Path(__file__).parent / "junit.xsd"


@pytest.fixture(scope="module")
def rigs():
    return [checked(run_with({"rear": SHIFT}, without=("left",))), checked(run_with())]


def test_junit_counts_failures_and_errors(rigs):
    suites = ElementTree.fromstring(junit_xml(rigs, TIME)).findall("testsuite")
    assert [(each.get("tests"), each.get("failures"), each.get("errors")) for each in suites] == [
        ("3", "1", "1"),
        ("3", "0", "0"),
    ]
    cases = {case.get("name"): case for case in suites[0].findall("testcase")}
    assert cases["rear"].find("failure").get("message") == "50 mm is above 30 mm"
    assert cases["left"].find("error").get("type") == "undecided"
    assert list(cases["front"]) == []
    assert suites[0].get("timestamp") == TIME


def junit_errors(report: str) -> list[str]:
    schema = etree.XMLSchema(etree.parse(SCHEMA))
    schema.validate(etree.fromstring(report.encode()))
    return [error.message for error in schema.error_log]


def test_junit_is_valid_against_its_schema(rigs):
    name = "a<b>&\"'\x01\x1b[0m\ud800"
    lidars = tuple(each.model_copy(update={"lidar": name}) for each in rigs[0].lidars)
    hostile = rigs[0].model_copy(update={"name": name, "lidars": lidars})
    assert {each.verdict for each in rigs[0].lidars} == {"within", "outside", "undecided"}
    for checks in ([], rigs, rigs[1:], [hostile]):
        assert junit_errors(junit_xml(checks, TIME)) == []
        summary_markdown(checks, "x\ud800").encode()
        code_quality_json(checks, "x\ud800").encode()
        code_quality_json(checks, "x").encode()


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ('tests="3"', 'tests="three"'),
        ('hostname="localhost"', 'host="localhost"'),
        (TIME, f"{TIME}+01:00"),
        ("<system-err />", ""),
        ("</testsuite>", "<properties /></testsuite>"),
        ('type="outside"', ""),
    ],
)
def test_the_schema_refuses_what_readers_may_refuse(rigs, right, wrong):
    report = junit_xml(rigs, TIME)
    assert right in report
    assert junit_errors(report.replace(right, wrong)) != []


def test_the_summary_has_a_row_per_lidar_and_escapes_names(rigs):
    text = summary_markdown(rigs, "calibration.toml", "summary.md.png")
    rows = [line for line in text.splitlines() if line.startswith("| ") and not line.startswith("| LiDAR")]
    assert [row.split(" | ")[0] for row in rows] == ["| front", "| left", "| rear"] * 2
    assert all(row.count("|") == 7 for row in rows)
    assert "50.0 ± 1.0 mm" in rows[2]
    assert text.startswith("## LiDAR extrinsics: OUTSIDE")
    assert "![differences as shares of the tolerances](summary.md.png)" in text


@pytest.mark.parametrize(("shift_m", "bar"), [(0.0, ".........."), (0.0299, "#####....."), (0.06, "##########")])
def test_the_bar_of_the_summary_is_half_full_at_the_tolerance(shift_m, bar):
    rig = checked(run_with({"rear": ((shift_m, 0.0, 0.0), (0.0, 0.0, 0.0))}))
    (row,) = (line for line in summary_markdown([rig], "x").splitlines() if line.startswith("| rear |"))
    assert f"| `{bar}` {100.0 * shift_m / 0.03:.0f} % |" in row


def test_annotations_name_what_is_not_within(rigs):
    error, warning = sorted(github_annotations(rigs))
    assert error == "::error title=rear is outside::run: rear: 50 mm is above 30 mm"
    assert warning.startswith("::warning title=left is undecided::run: left: not placed")
    findings = json.loads(code_quality_json(rigs, "calibration.toml"))
    assert [each["severity"] for each in findings] == ["minor", "major"]
    assert {each["location"]["path"] for each in findings} == {"calibration.toml"}
    assert len({each["fingerprint"] for each in findings}) == 2


def test_a_name_cannot_end_an_annotation_or_a_table():
    check = checked(run_with({"rear": SHIFT}))
    lidars = tuple(each.model_copy(update={"lidar": "a|b\n::error::x%<b>"}) for each in check.lidars)
    hostile = check.model_copy(update={"lidars": lidars})
    (line, *_) = github_annotations([hostile.model_copy(update={"lidars": lidars[-1:]})])
    assert "\n" not in line
    assert "\\x0a%3A%3Aerror" in line
    assert "a\\|b" in summary_markdown([hostile], "x")
    assert "<b>" not in summary_markdown([hostile], "x")


def test_the_document_has_every_number(rigs):
    document = json.loads(check_document(rigs, "calibration.toml").model_dump_json())
    rear = document["rigs"][0]["lidars"]["rear"]
    assert (document["verdict"], rear["verdict"]) == ("outside", "outside")
    assert (rear["distance_m"], rear["max_translation_m"]) == (pytest.approx(0.05), 0.03)
    assert rear["sigma_m"] == pytest.approx(0.001)
    assert document["rigs"][0]["lidars"]["left"]["distance_m"] is None


def test_the_bar_ends_where_the_difference_does(rigs):
    image = Image.open(io.BytesIO(check_png(rigs[:1]))).convert("RGB")
    red = [x for x in range(image.width) for y in range(image.height) if image.getpixel((x, y)) == (0xC8, 0x32, 0x2B)]
    start, end = 24 + 220, 960 - 2 * 24
    assert max(red) == pytest.approx(start + (end - start) * (0.05 / 0.03) / 2.0, abs=2)


def test_the_picture_has_a_row_per_lidar(rigs):
    image = Image.open(io.BytesIO(check_png(rigs))).convert("RGB")
    assert image.size == (960, 2 * 24 + 44 * (2 + 6 + 1))
    rows = [24 + 44 * row for row in (1, 2, 3, 5, 6, 7)]
    colours = {"outside": (0xC8, 0x32, 0x2B), "undecided": (0xB8, 0x86, 0x0B), "within": (0x2E, 0x8B, 0x57)}
    for top, check in zip(rows, (each for rig in rigs for each in rig.lidars), strict=True):
        row = image.crop((0, top, 960, top + 44))
        names, bars = ({*each.getdata()} for each in (row.crop((0, 4, 240, 40)), row.crop((240, 4, 960, 40))))
        assert colours[check.verdict] in names
        assert colours[check.verdict] in bars
        assert not ({*colours.values()} - {colours[check.verdict]}) & (names | bars)
        assert not {*image.crop((0, top - 4, 960, top + 4)).getdata()} & {*colours.values()}
    ink = (0x22, 0x22, 0x22)
    tolerance = image.crop((572, rows[0], 584, rows[2] + 44))
    assert all(any(tolerance.getpixel((x, y)) == ink for x in range(12)) for y in range(tolerance.height))
    assert ink in image.crop((0, rows[-1] + 44 + 4, 960, image.height)).getdata()
    above_the_bars = [image.getpixel((x, rows[0] + 1)) for x in range(image.width)]
    assert [above_the_bars.count(colour) for colour in (ink, (0xBB, 0xBB, 0xBB))] == [2, 2]


def test_the_picture_has_sigmas_where_they_are_known():
    ink, run = (0x22, 0x22, 0x22), run_with({"rear": SHIFT}, sigma_m=0.005)
    bare = replace(run, placements=tuple(replace(each, covariance=None) for each in run.placements))
    ends = []
    for each in (run, bare):
        check = checked(each).model_copy(update={"lidars": checked(each).lidars[-1:]})
        image = Image.open(io.BytesIO(check_png([check]))).convert("RGB")
        row = 24 + 44 + 4 + 6
        ends.append([x for x in range(700, 960) if image.getpixel((x, row)) == ink])
    scale = (960 - 48 - 244) / 2.0 / 0.03
    assert (min(ends[0]), max(ends[0])) == pytest.approx((244 + 0.045 * scale, 244 + 0.055 * scale), abs=2)
    assert ends[1] == []


def test_reports_are_written_and_a_step_summary_is_added_to(rigs, tmp_path):
    step = tmp_path / "step.md"
    step.write_text("before\n")
    names = {"junit": "of/ci/j.xml", "summary": "pages/s.md", "code_quality": "q.json"}
    written = write_reports(
        rigs, "ref", TIME, **{key: tmp_path / name for key, name in names.items()}, step_summary=str(step)
    )
    assert [path.name for path in written] == ["j.xml", "s.md", "s.md.png", "q.json"]
    assert all(path.stat().st_size > 100 for path in written)
    assert step.read_text().startswith("before\n## LiDAR extrinsics: OUTSIDE")
