# SPDX-License-Identifier: Apache-2.0
"""A result as a data frame and as a table of HTML."""

from __future__ import annotations

import math
import re
import sys
from html.parser import HTMLParser

import numpy as np
import pytest

from multilica.errors import MissingDependencyError
from multilica.geometry import RigidTransform
from multilica.results import CalibrationResult, LidarPlacement
from multilica.results.calibration import TABLE_COLUMNS, table_rows

HOSTILE = "<script src=https://example.com/x.js>\x1b[31m"
SIGMAS_RAD, SIGMAS_M = (1e-3, 2e-3, 3e-3), (0.01, 0.02, 0.03)
POSE = RigidTransform.from_xyz_rpy("roof", "left", [1.0, -2.0, 0.5], np.deg2rad([10.0, -20.0, 30.0]).tolist())


@pytest.fixture
def result() -> CalibrationResult:
    covariance = np.diag(np.square([*SIGMAS_RAD, *SIGMAS_M]))
    return CalibrationResult(
        "roof",
        "made",
        (
            LidarPlacement(HOSTILE, f"it is alone, {HOSTILE}"),
            LidarPlacement("left", "placed", "placed", POSE, 0.7, 0.02, covariance),
            LidarPlacement("roof", "the target", "placed", RigidTransform.identity("roof", "roof")),
        ),
    )


class Cells(HTMLParser):
    """The texts of the cells by row, and all tags."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.tags: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        del attrs
        self.tags.add(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("th", "td"):
            self.rows[-1].append("")

    def handle_data(self, data: str) -> None:
        if self.rows:
            self.rows[-1][-1] += data


def test_rows_have_every_figure_in_its_unit(result: CalibrationResult) -> None:
    row = table_rows(result)[1]
    assert [*row] == [*TABLE_COLUMNS]
    assert (row["lidar"], row["target"], row["status"], row["reason"]) == ("left", "roof", "placed", "placed")
    assert [row[name] for name in ("x_m", "y_m", "z_m")] == pytest.approx([1.0, -2.0, 0.5])
    assert [row[name] for name in ("roll_deg", "pitch_deg", "yaw_deg")] == pytest.approx([10.0, -20.0, 30.0])
    assert [row[name] for name in ("qx", "qy", "qz", "qw")] == pytest.approx(POSE.quaternion_xyzw.tolist())
    assert [row[f"sigma_{axis}_m"] for axis in "xyz"] == pytest.approx(SIGMAS_M)
    assert [row[f"sigma_about_{axis}_deg"] for axis in "xyz"] == pytest.approx(np.rad2deg(SIGMAS_RAD).tolist())
    assert (row["fitness"], row["rmse_m"]) == (0.7, 0.02)


def test_what_is_not_known_is_nan(result: CalibrationResult) -> None:
    refused, _, target = table_rows(result)
    numbers = [*TABLE_COLUMNS][3:-1]
    assert refused["status"] == "not_placed"
    assert all(math.isnan(refused[name]) for name in numbers)
    assert target["status"] == "target"
    assert [name for name in numbers if math.isnan(target[name])] == numbers[10:]
    assert target["qw"] == 1.0


def test_the_data_frame_has_a_row_per_lidar(result: CalibrationResult) -> None:
    pytest.importorskip("pandas")
    frame = result.to_dataframe()
    assert [*frame.columns] == [*TABLE_COLUMNS]
    assert frame["lidar"].tolist() == [HOSTILE, "left", "roof"]
    assert frame.dtypes["sigma_x_m"] == np.float64
    assert frame.set_index("lidar").loc["left", "yaw_deg"] == pytest.approx(30.0)


def test_without_pandas_the_command_is_told(result: CalibrationResult, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingDependencyError, match=r"`to_dataframe` needs .* pandas, .*`pip install pandas`"):
        result.to_dataframe()


def test_the_table_shows_poses_sigmas_and_reasons(result: CalibrationResult) -> None:
    page = Cells(result._repr_html_())
    head = ["LiDAR", "status", "x m", "y m", "z m", "roll deg", "pitch deg", "yaw deg", "sigma mm", "sigma deg"]
    assert page.rows[0] == [*head, "fitness"]
    shown = HOSTILE.replace("\x1b", "\\x1b")
    assert page.rows[1] == [shown, "not placed", *["-"] * 9]
    assert page.rows[2] == ["", f"it is alone, {shown}"]
    pose = ["1.000", "-2.000", "0.500", "10.00", "-20.00", "30.00"]
    assert page.rows[3] == ["left", "placed", *pose, "30.0", "0.172", "0.700"]
    assert page.rows[4] == ["roof", "target", *["0.000"] * 3, *["0.00"] * 3, *["-"] * 3]


def test_the_table_is_inert_and_has_no_colour_of_its_own(result: CalibrationResult) -> None:
    text = result._repr_html_()
    assert Cells(text).tags == {"table", "caption", "thead", "tbody", "tr", "th", "td", "b"}
    assert not re.search(r"\b(src|href|url|on\w+)\s*[=(](?!https://example)", text)
    assert {*re.findall(r"(?<!-)\b(?:color|background):([^;\"]+)", text)} == {"inherit", "none"}
