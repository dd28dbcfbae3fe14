# SPDX-License-Identifier: Apache-2.0
"""Reports of checks in the formats of CI services: JUnit, Markdown with a picture, annotations."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from multilica.checks.comparison import CheckVerdict, LidarCheck, RigCheck, joint_verdict
from multilica.errors import escape_controls
from multilica.sinks.files.atomic import atomic_file, require_writable, write_text_atomically

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont, ImageFont

VERDICT_WORDS: dict[CheckVerdict, str] = {"within": "within", "outside": "OUTSIDE", "undecided": "UNDECIDED"}
NOT_MEASURED = "not measured"
"""The word for a LiDAR that is within at another stop."""
_BAR = 10
_FULL_SHARE = 2.0
"""A bar ends at twice the tolerance."""
_WIDTH_PX, _ROW_PX, _MARGIN_PX, _NAME_PX, _FONT_PX = 960, 44, 24, 220, 16
_COLOURS: dict[CheckVerdict, str] = {"within": "#2e8b57", "outside": "#c8322b", "undecided": "#b8860b"}
_INK, _GRID, _PAPER = "#222222", "#bbbbbb", "#ffffff"


def write_reports(
    rigs: Sequence[RigCheck],
    reference: str,
    timestamp: str,
    *,
    junit: Path | None = None,
    summary: Path | None = None,
    code_quality: Path | None = None,
    step_summary: str | None = None,
) -> list[Path]:
    """Write the reports that are asked for, each whole or not at all, and return their paths.

    Folders that are missing are made.

    Args:
        timestamp: of the check, ISO 8601 without a time zone.
        summary: gets a picture beside it, with `.png` added to its name.
        step_summary: file of GitHub Actions that the summary is added to.
    """
    written = []
    require_reports(junit, summary, code_quality)
    if junit is not None:
        write_text_atomically(junit, junit_xml(rigs, timestamp))
        written.append(junit)
    if summary is not None:
        picture = summary.with_name(f"{summary.name}.png")
        with atomic_file(picture) as stream:
            stream.write(check_png(rigs))
        write_text_atomically(summary, summary_markdown(rigs, reference, picture.name))
        written += [summary, picture]
    if code_quality is not None:
        write_text_atomically(code_quality, code_quality_json(rigs, reference))
        written.append(code_quality)
    if step_summary is not None:
        with Path(step_summary).open("a", encoding="utf-8") as stream_of_step:
            stream_of_step.write(summary_markdown(rigs, reference))
    return written


def require_reports(*paths: Path | None) -> None:
    """Make the folders of reports, and raise OSError if one of these cannot be written, before the work is done."""
    for path in filter(None, paths):
        require_writable(path)


def word_of(check: LidarCheck) -> str:
    """Return the verdict on a LiDAR, for people."""
    return NOT_MEASURED if check.elsewhere else VERDICT_WORDS[check.verdict]


def junit_xml(rigs: Sequence[RigCheck], timestamp: str) -> str:
    """Return a JUnit report: a suite per rig and a test case per LiDAR; what is undecided is an error.

    A LiDAR that a stop did not measure, and another one found within, is skipped there.
    """
    root = Element("testsuites")
    for number, rig in enumerate(map(_printable, rigs)):
        count = {verdict: sum(each.verdict == verdict for each in rig.lidars) for verdict in VERDICT_WORDS}
        suite = SubElement(
            root,
            "testsuite",
            name=rig.name,
            package="multilica",
            id=str(number),
            timestamp=timestamp,
            hostname="localhost",
            tests=str(len(rig.lidars)),
            failures=str(count["outside"]),
            errors=str(count["undecided"]),
            time="0",
        )
        SubElement(suite, "properties")
        for each in rig.lidars:
            case = SubElement(suite, "testcase", name=each.lidar, classname=f"multilica.{rig.name}", time="0")
            if each.elsewhere:
                SubElement(case, "skipped")
            elif each.verdict != "within":
                kind = "failure" if each.verdict == "outside" else "error"
                SubElement(case, kind, type=each.verdict, message=each.reason).text = f"{each.lidar}: {each.reason}"
        elsewhere = [f"{each.lidar}: {each.reason}" for each in rig.lidars if each.elsewhere]
        SubElement(suite, "system-out").text = "\n".join((rig.sentence, *elsewhere, *rig.notes))
        SubElement(suite, "system-err")
    indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(root, encoding="unicode") + "\n"


def summary_markdown(rigs: Sequence[RigCheck], reference: str, picture: str = "") -> str:
    """Return a summary in Markdown, with the picture at an address unless that is empty."""
    verdict = joint_verdict([rig.verdict for rig in rigs])
    lines = [f"## LiDAR extrinsics: {VERDICT_WORDS[verdict]}", "", f"Reference: `{escape_controls(reference)}`", ""]
    if picture:
        lines += [f"![differences as shares of the tolerances]({picture})", ""]
        lines += ["Upper bars: translation; lower bars: rotation; thin lines: one sigma.", ""]
    for rig in map(_printable, rigs):
        lines += [f"### {_text(rig.name)}", "", _text(rig.sentence), ""]
        lines += [
            "| LiDAR | verdict | translation | rotation | of the tolerance | reason |",
            "|---|---|---|---|---|---|",
        ]
        lines += [_row(each) for each in rig.lidars]
        lines += ["", f"Compared to {_text(rig.root)}.", *(f"Note: {_text(note)}." for note in rig.notes), ""]
    return "\n".join(lines)


def _row(check: LidarCheck) -> str:
    cells = [_text(check.lidar), word_of(check) if check.verdict == "within" else f"**{word_of(check)}**"]
    if check.distance_m is None or check.angle_deg is None or check.share is None:
        cells += ["-", "-", "-"]
    else:
        filled = "#" * min(_BAR, round(_BAR * check.share / _FULL_SHARE))
        cells += [
            _with_sigma(1000.0 * check.distance_m, check.sigma_m and 1000.0 * check.sigma_m, "mm", 1),
            _with_sigma(check.angle_deg, check.sigma_deg, "deg", 3),
            f"`{filled:.<{_BAR}}` {100.0 * check.share:.0f} %",
        ]
    return f"| {' | '.join([*cells, _text(check.reason)])} |"


def _with_sigma(value: float, sigma: float | None, unit: str, digits: int) -> str:
    shown = f"{value:.{digits}f}"
    return f"{shown} {unit}" if sigma is None else f"{shown} ± {sigma:.{digits}f} {unit}"


def _text(value: str) -> str:
    """Escape what Markdown would take for its own."""
    escaped = value.replace("\\", "\\\\")
    for character in "`*_{}[]<>|#!":
        escaped = escaped.replace(character, f"\\{character}")
    return " ".join(escaped.split())


def github_annotations(rigs: Sequence[RigCheck]) -> Iterator[str]:
    """Yield a workflow command of GitHub Actions for each LiDAR that is not within its tolerance."""
    for rig, each in _findings(rigs):
        level = "error" if each.verdict == "outside" else "warning"
        title = _escaped(f"{each.lidar} is {each.verdict}", more=":,")
        yield f"::{level} title={title}::{_escaped(f'{rig.name}: {each.lidar}: {each.reason}')}"


def _escaped(value: str, more: str = "") -> str:
    """Escape as the runner of GitHub Actions does."""
    for character in f"%\r\n{more}":
        value = value.replace(character, f"%{ord(character):02X}")
    return value


def code_quality_json(rigs: Sequence[RigCheck], reference: str) -> str:
    """Return a code quality report of GitLab: a finding at the reference for each LiDAR not within its tolerance."""
    findings = [
        {
            "description": f"{rig.name}: {each.lidar} is {each.verdict}: {each.reason}",
            "check_name": "multilica-check",
            "fingerprint": hashlib.sha256(f"{rig.name}\n{each.lidar}\n{each.verdict}".encode()).hexdigest(),
            "severity": "major" if each.verdict == "outside" else "minor",
            "location": {"path": escape_controls(reference), "lines": {"begin": 1}},
        }
        for rig, each in _findings(rigs)
    ]
    return json.dumps(findings, indent=2, ensure_ascii=False) + "\n"


def _findings(rigs: Sequence[RigCheck]) -> Iterator[tuple[RigCheck, LidarCheck]]:
    return ((rig, each) for rig in map(_printable, rigs) for each in rig.lidars if each.verdict != "within")


def _printable(rig: RigCheck) -> RigCheck:
    """Show controls, which names in logs may have and XML and UTF-8 may not, as escapes."""
    lidars = tuple(
        each.model_copy(update={"lidar": escape_controls(each.lidar), "reason": escape_controls(each.reason)})
        for each in rig.lidars
    )
    names = {"name": escape_controls(rig.name), "root": escape_controls(rig.root)}
    return rig.model_copy(update={**names, "lidars": lidars, "notes": tuple(map(escape_controls, rig.notes))})


def check_png(rigs: Sequence[RigCheck]) -> bytes:
    """Draw two bars per LiDAR, translation above rotation, with the tolerance as a line and sigma as a whisker."""
    from PIL import Image, ImageDraw, ImageFont  # takes as long to import as all else of a report

    rows = [(rig, check) for rig in rigs for check in rig.lidars]
    height = 2 * _MARGIN_PX + _ROW_PX * (len(rows) + len(rigs)) + _ROW_PX
    image = Image.new("RGB", (_WIDTH_PX, height), _PAPER)
    pen = ImageDraw.Draw(image)
    font = ImageFont.load_default(_FONT_PX)
    y = _MARGIN_PX
    for rig in rigs:
        pen.text((_MARGIN_PX, y), f"{rig.name}: {rig.verdict}, compared to {rig.root}", fill=_INK, font=font)
        y += _ROW_PX
        for check in rig.lidars:
            pen.text((_MARGIN_PX, y + 6), check.lidar, fill=_COLOURS[check.verdict], font=font)
            _draw_bars(pen, font, check, y)
            y += _ROW_PX
    for share, label in ((0.0, "0"), (1.0, "tolerance"), (_FULL_SHARE, "2 x")):
        x = _x(share)
        pen.line((x, _MARGIN_PX + _ROW_PX, x, y), fill=_INK if share == 1.0 else _GRID, width=2 if share == 1.0 else 1)
        pen.text((x, y + 6), label, fill=_INK, font=font, anchor="ma")
    stream = io.BytesIO()
    image.save(stream, "PNG", optimize=True)
    return stream.getvalue()


def _x(share: float) -> float:
    left = _MARGIN_PX + _NAME_PX
    return left + (_WIDTH_PX - 2 * _MARGIN_PX - left) * min(share, _FULL_SHARE) / _FULL_SHARE


def _draw_bars(pen: ImageDraw, font: ImageFont | FreeTypeFont, check: LidarCheck, y: int) -> None:
    if check.distance_m is None or check.angle_deg is None:
        told = NOT_MEASURED if check.elsewhere else "not placed"
        pen.text((_x(0.0) + 8, y + 6), told, fill=_COLOURS[check.verdict], font=font)
        return
    of_translation = check.distance_m, check.sigma_m, check.max_translation_m
    of_rotation = check.angle_deg, check.sigma_deg, check.max_rotation_deg
    for top, (off, sigma, limit) in zip((y + 4, y + 20), (of_translation, of_rotation), strict=True):
        pen.rectangle((_x(0.0), top, max(_x(off / limit), _x(0.0) + 1), top + 12), fill=_COLOURS[check.verdict])
        if sigma is not None:
            ends = _x(max(0.0, off - sigma) / limit), _x((off + sigma) / limit)
            pen.line((ends[0], top + 6, ends[1], top + 6), fill=_INK, width=2)
