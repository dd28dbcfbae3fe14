# SPDX-License-Identifier: Apache-2.0
"""Standard deviations drawn on the rig."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from multilica.geometry import RigidTransform
from multilica.sinks.report.contents import ReportContents
from multilica.sinks.report.rig import rig_drawing
from tests.sinks.report.conftest import made_contents, with_values

LEVEL = RigidTransform.identity("level", "top")
REAR_M = np.array([-2.0, 0.1, -0.5])
LEFT_M = np.array([1.5, 0.7, -0.4])


def contents_with(sigma_xyz_m: tuple[float, float, float], sigma_deg: tuple[float, float, float]) -> ReportContents:
    """A complete run whose rear LiDAR has these standard deviations, without correlations."""
    contents = made_contents("complete")
    lidars = contents.document.model_dump(mode="json")["lidars"]
    lidars["rear"]["covariance"] = np.diag([*np.deg2rad(sigma_deg) ** 2, *np.square(sigma_xyz_m)]).tolist()
    return with_values(contents, lidars=lidars)


def marks_of(contents: ReportContents, level: RigidTransform = LEVEL):
    drawing = rig_drawing(replace(contents, level=level))
    return drawing, [{mark.name: mark for mark in view.marks} for view in drawing.views]


def scale_of(marks) -> float:
    """Pixels per metre, from the places of two LiDARs."""
    (ax, ay), (bx, by) = marks["rear"].at, marks["front left/1"].at
    return math.hypot(bx - ax, by - ay) / float(np.linalg.norm((LEFT_M - REAR_M)[:2]))


def test_ellipses_are_three_enlarged_sigmas_along_their_axes():
    drawing, (top, side) = marks_of(contents_with((0.01, 0.002, 0.004), (0.1, 0.1, 0.1)))
    scale = scale_of(top)
    longest, shortest, angle = top["rear"].ellipse
    assert longest == pytest.approx(3.0 * drawing.enlarged * scale * 0.01, rel=0.01)
    assert shortest == pytest.approx(3.0 * drawing.enlarged * scale * 0.002, rel=0.02)
    assert angle % 180.0 == pytest.approx(0.0, abs=0.1)
    assert side["rear"].ellipse[:2] == pytest.approx((longest, 2.0 * shortest), rel=0.02)
    assert top["top"].ellipse is None  # the target is the reference


@pytest.mark.parametrize("sigma_m", [1e-6, 0.0007, 0.02, 0.2, 5.0])
def test_the_enlargement_keeps_every_ellipse_in_the_picture(sigma_m):
    drawing, views = marks_of(contents_with((sigma_m,) * 3, (0.1, 0.1, 0.1)))
    for view, marks in zip(drawing.views, views, strict=True):
        for mark in (mark for mark in marks.values() if mark.ellipse):
            assert mark.ellipse[0] < mark.at[0] < view.size_px[0] - mark.ellipse[0]
            assert mark.ellipse[0] < mark.at[1] < view.size_px[1] - mark.ellipse[0]
    assert drawing.enlarged == 1 or views[0]["rear"].ellipse[0] > 10.0 or sigma_m < 1e-5


def test_a_fan_opens_by_three_enlarged_sigmas_of_the_turn():
    drawing, (top, side) = marks_of(contents_with((0.01, 0.01, 0.01), (0.01, 0.05, 0.2)))

    def half_angle_deg(mark) -> float:
        numbers = [float(word) for word in mark.fan.replace("M", "").replace("L", " ").replace("A", " ").split()[:4]]
        first = math.atan2(numbers[3] - numbers[1], numbers[2] - numbers[0])
        along = math.atan2(mark.forward[1] - mark.at[1], mark.forward[0] - mark.at[0])
        return math.degrees(along - first) % 360.0

    assert half_angle_deg(top["rear"]) == pytest.approx(3.0 * drawing.turned * 0.2, abs=0.3)
    assert half_angle_deg(side["rear"]) == pytest.approx(3.0 * drawing.turned * 0.05, abs=0.3)


def test_a_rig_that_is_wider_than_long_is_drawn_lengthwise():
    turned = RigidTransform.from_xyz_rpy("level", "top", (0.0, 0.0, 0.0), (0.0, 0.0, math.pi / 2.0))
    drawing, (top, _) = marks_of(contents_with((0.01, 0.002, 0.004), (0.1, 0.1, 0.1)), turned)
    assert drawing.views[0].caption == "From above: x up, y to the left."
    assert abs(top["rear"].at[0] - top["front left/1"].at[0]) > abs(top["rear"].at[1] - top["front left/1"].at[1])
    assert top["rear"].ellipse[2] % 180.0 == pytest.approx(0.0, abs=0.1)


def test_without_any_covariance_there_is_no_drawing():
    contents = made_contents("complete")
    lidars = contents.document.model_dump(mode="json")["lidars"]
    for entry in lidars.values():
        entry["covariance"] = None
    assert rig_drawing(with_values(contents, lidars=lidars)) is None
    assert rig_drawing(made_contents("complete", until="coarse")) is None


@pytest.mark.slow
def test_an_uncertain_lidar_stands_out(open_report):
    page = open_report("uncertain")
    ellipses = page.locator(".sigma.uncertain ellipse")
    assert ellipses.count() == 2
    assert ellipses.first.evaluate("(element) => getComputedStyle(element).strokeDasharray") != "none"
    assert page.locator("svg.rig text", has_text="UNCERTAIN").count() == 2
