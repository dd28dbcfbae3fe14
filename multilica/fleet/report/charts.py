# SPDX-License-Identifier: Apache-2.0
"""Geometry of the charts of poses over time: plots of a LiDAR, and small lines of a vehicle; in SVG pixels."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from multilica.fleet.drift.findings import Finding
from multilica.fleet.lidar_series import LidarSeries
from multilica.fleet.store.records import day_of
from multilica.geometry import FloatArray

WIDTH_PX, LEFT_PX, RIGHT_PX, STRIP_PX = 470.0, 82.0, 462.0, 62.0
"""Width of a plot, left and right edge of its strips, and their height."""
_GAP_PX = 13.0
_LABEL_ROW_PX = 17.0
_LETTER_PX = 9.5
_RING = 3.4, "a3.4 3.4 0 1 0 6.8 0a3.4 3.4 0 1 0-6.8 0z"
_DIAMOND = 4.6, "l4.6-4.6 4.6 4.6-4.6 4.6z"
_NEARLY_ALL = 0.9
_QUANTITIES = (
    ("translation", "mm", ("x", "y", "z"), 12.0, 1),
    ("rotation", "deg", ("roll", "pitch", "yaw"), 0.12, 3),
)
"""Name, unit, components, least half range of an axis, and decimals.

The least range is 40 percent of what `fleet run` takes for no motion by default, so that noise looks small.
"""
LINE_WIDTH_PX, LINE_HEIGHT_PX = 76, 26
_LINE_MARGIN_PX = 2.5
_TALLEST = 8.0
"""Times the median vehicle: taller ones are cut off, so that one wrong pose does not flatten the others."""
_NS_PER_DAY = 86_400 * 10**9
_MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")
_MOST_TICKS = 7
_STEPS_DAYS = (1, 2, 5, 10)
_STEPS_MONTHS = (1, 2, 3, 6, 12, 24, 60, 120, 240)
_DAYS_PER_MONTH = 30.44
_EPOCH_MONTHS = 12 * 1970
_PADDING = 0.03
_LEAST_DAYS = 3.0


@dataclass(frozen=True, slots=True)
class TimeAxis:
    """A range of times over a range of pixels."""

    begin_ns: int
    end_ns: int
    left_px: float
    right_px: float

    @classmethod
    def around(cls, times_ns: npt.NDArray[np.int64], left_px: float, right_px: float) -> TimeAxis:
        """Create an axis that shows all times (N,), N > 0, of at least three days."""
        first, last = int(times_ns.min()), int(times_ns.max())
        margin = int(max(_PADDING * (last - first), (_LEAST_DAYS * _NS_PER_DAY - (last - first)) / 2.0))
        return cls(first - margin, last + margin, left_px, right_px)

    def place(self, times_ns: npt.ArrayLike) -> FloatArray:
        """Return the pixels of times."""
        share = (np.asarray(times_ns, dtype=np.float64) - self.begin_ns) / (self.end_ns - self.begin_ns)
        return np.asarray(self.left_px + share * (self.right_px - self.left_px))

    def ticks(self) -> list[tuple[float, str]]:
        """Return pixels and labels of at most eight ticks; the first one and January name the year."""
        days = (self.end_ns - self.begin_ns) / _NS_PER_DAY
        step = next((step for step in _STEPS_DAYS if days / step <= _MOST_TICKS), None)
        if step is not None:
            dates = self._calendar("M8[D]")[::step]
        else:
            fitting = (step for step in _STEPS_MONTHS if days / (_DAYS_PER_MONTH * step) <= _MOST_TICKS)
            months = self._calendar("M8[M]")
            dates = months[(months.astype(int) + _EPOCH_MONTHS) % next(fitting, _STEPS_MONTHS[-1]) == 0]
        columns = self.place(dates.astype("M8[ns]").astype(np.int64)).tolist()
        labels = (_label(date, named=step is not None, first=not index) for index, date in enumerate(dates))
        return list(zip(columns, labels, strict=True))

    def _calendar(self, unit: str) -> npt.NDArray[np.datetime64]:
        """Return the days or months that begin within the axis."""
        begin, end = np.array([self.begin_ns, self.end_ns]).astype("M8[ns]").astype(unit)
        return np.arange(begin + 1, end + 1)


def _label(date: np.datetime64, *, named: bool, first: bool) -> str:
    year, month, day = str(date.astype("M8[D]")).split("-")
    if month == "01" and not named:
        return year
    return f"{f'{int(day)} ' if named else ''}{_MONTHS[int(month) - 1]}{f' {year}' if first else ''}"


def number(value: float, digits: int = 1) -> str:
    """Return a number without trailing zeros."""
    text = f"{value:z.{digits}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def drift_plots(series: LidarSeries, events: Sequence[Finding], *, texts: bool) -> list[dict[str, Any]]:
    """Return the plots of translation and rotation; none for a LiDAR that never had a pose at a known time.

    Args:
        events: of this LiDAR.
        texts: tell date and values of each log where the pointer rests.

    Returns:
        For each plot its three strips as path data, the spans of events, and columns in pixels: with their labels of
        the `months`, with width and text of the `logs`, and of the logs that are `missing` a pose.
    """
    if not len(series):
        return []
    periods = [(event, period) for event in events if (period := event.period_ns) is not None]
    bounds_ns = np.array([bound for _, period in periods for bound in period], dtype=np.int64)
    axis = TimeAxis.around(np.concatenate([series.time_ns, series.missing_ns, bounds_ns]), LEFT_PX, RIGHT_PX)
    spans, rows = _spans(periods, axis)
    columns, offsets, sigmas = axis.place(series.time_ns), series.offsets_from_median(), series.sigmas()
    shared = {"spans": spans, "months": axis.ticks(), "missing": axis.place(series.missing_ns).tolist()}
    plots = []
    for index, part in enumerate((slice(3), slice(3, 6))):
        own = columns, offsets[:, part], sigmas[:, part]
        logs = _areas(series, *own, index) if texts else ()
        plots.append({**shared, "logs": logs, **_plot(series, *own, index, 6.0 + rows * _LABEL_ROW_PX)})
    return plots


def _plot(
    series: LidarSeries, columns: FloatArray, offsets: FloatArray, sigmas: FloatArray, index: int, top: float
) -> dict[str, Any]:
    title, unit, names, least, digits = _QUANTITIES[index]
    sizes = np.linalg.norm(offsets, axis=1)
    worst = int(np.argmax(sizes))
    # All offsets are shown, and nearly all of their bands.
    bands = float(np.quantile(np.abs(offsets) + np.nan_to_num(sigmas), _NEARLY_ALL))
    limit = max(least, 1.1 * float(np.abs(offsets).max()), 1.05 * bands)
    calibrated = np.isin(np.arange(len(series)), list(series.calibrated))
    tops = [top + i * (STRIP_PX + _GAP_PX) for i in range(3)]
    return {
        "title": title,
        "unit": unit,
        "summary": f"{series.lidar}, {title}: at most {sizes[worst]:.{digits}f} {unit} from the median, "
        f"on {day_of(int(series.time_ns[worst]))}",
        "top": top,
        "bottom": tops[-1] + STRIP_PX,
        "strips": [
            {"name": name} | _strip(columns, offsets[:, i], sigmas[:, i], limit, calibrated, tops[i])
            for i, name in enumerate(names)
        ],
    }


def _strip(
    columns: FloatArray,
    offsets: FloatArray,
    sigmas: FloatArray,
    limit: float,
    calibrated: npt.NDArray[np.bool_],
    top: float,
) -> dict[str, Any]:
    def row(values: npt.ArrayLike) -> FloatArray:
        return np.asarray(top + STRIP_PX * (0.5 - np.clip(np.divide(values, limit), -1.0, 1.0) / 2.0))

    tick = _nice_below(0.85 * limit)
    places = np.column_stack([columns, row(offsets)])
    return {
        "top": top,
        "ticks": [
            (float(row(at)), "0" if at == 0.0 else f"{at:+g}".replace("-", "\u2212")) for at in (tick, 0.0, -tick)
        ],
        "band": _band(columns, row(offsets + sigmas), row(offsets - sigmas), np.isfinite(sigmas)),
        "line": _path(places),
        "rings": _marks(places[~calibrated], *_RING),
        "diamonds": _marks(places[calibrated], *_DIAMOND),
    }


def _path(places: npt.ArrayLike) -> str:
    return "M" + " ".join(f"{number(x)} {number(y)}" for x, y in np.asarray(places))


def _marks(places: FloatArray, half_px: float, shape: str) -> str:
    return "".join(f"M{number(x - half_px)} {number(y)}{shape}" for x, y in places)


def _band(columns: FloatArray, upper: FloatArray, lower: FloatArray, known: npt.NDArray[np.bool_]) -> str:
    """Return an area per stretch of logs with known sigma; a bar for a log alone."""
    areas = []
    for stretch in np.split(np.arange(len(known)), np.flatnonzero(np.diff(known)) + 1):
        if not known[stretch[0]]:
            continue
        x, high, low = columns[stretch], upper[stretch], lower[stretch]
        if len(stretch) == 1:
            x, high, low = np.array([x[0] - 2.0, x[0] + 2.0]), np.repeat(high, 2), np.repeat(low, 2)
        outline = np.column_stack([np.concatenate([x, x[::-1]]), np.concatenate([high, low[::-1]])])
        areas.append(_path(outline) + "z")
    return "".join(areas)


def _spans(periods: Sequence[tuple[Finding, tuple[int, int]]], axis: TimeAxis) -> tuple[list[dict[str, Any]], int]:
    """Return the spans of events with labels that do not overlap, and the number of rows of labels."""
    spans, ends_px = [], list[float]()
    for event, period_ns in sorted(periods, key=lambda each: each[1][0]):
        left, right = axis.place(period_ns).tolist()
        line = (left + right) / 2.0 if event.kind == "jump" else left
        label = f"{event.kind} {event.when}"
        half_px = _LETTER_PX * len(label) / 2.0
        centre = min(max(line, LEFT_PX + half_px), RIGHT_PX - half_px)
        row = next((row for row, end in enumerate(ends_px) if end < centre - half_px), len(ends_px))
        ends_px[row : row + 1] = [centre + half_px]
        place = {"left": left, "width": max(right - left, 1.0), "line": line, "label_x": centre}
        label_y = _LABEL_ROW_PX * (row + 1) - 2.0
        spans.append({"kind": event.kind, "label": label, "label_y": label_y, **place})
    return spans, len(ends_px)


def _areas(
    series: LidarSeries, columns: FloatArray, offsets: FloatArray, sigmas: FloatArray, index: int
) -> tuple[tuple[float, float, str], ...]:
    """Return left edge, width and text of the area of each log, between the middles to its neighbours."""
    _, unit, names, _, digits = _QUANTITIES[index]
    edges = np.concatenate([[LEFT_PX], (columns[1:] + columns[:-1]) / 2.0, [RIGHT_PX]])

    def text(log: int) -> str:
        outcome = "calibrated" if log in series.calibrated else "verified"
        values = ", ".join(
            f"{name} {value:+.{digits}f}{'' if math.isnan(sigma) else f' ± {sigma:.{digits}f}'} {unit}"
            for name, value, sigma in zip(names, offsets[log], sigmas[log], strict=True)
        )
        doubt = ", uncertain" if log in series.uncertain else ""
        return f"{day_of(int(series.time_ns[log]))}, {outcome}{doubt}: {values} ({series.sources[log]})"

    return tuple((edges[log], edges[log + 1] - edges[log], text(log)) for log in range(len(columns)))


def _nice_below(value: float) -> float:
    """Return the largest round number, of one digit or 15, that is not above a positive value."""
    power = 10.0 ** math.floor(math.log10(value))
    return power * next(
        step for step in (8.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.5, 1.0) if step <= value / power * (1.0 + 1e-9)
    )


def sparklines(
    vehicles: Mapping[str, Sequence[LidarSeries]], columns: slice
) -> tuple[float, dict[str, dict[str, Any]]]:
    """Draw the distances of the LiDARs of each vehicle from their median poses, as small lines.

    Args:
        columns: of `LidarSeries.offsets_from_median`.

    Returns:
        The largest value of the scale, which is that of all vehicles and begins at zero. For each vehicle its largest
        value, whose it is, and per LiDAR its path data and whether it is that one, which comes last.
    """
    drawn = {}
    for name, histories in vehicles.items():
        own = [
            (np.linalg.norm(each.offsets_from_median()[:, columns], axis=1), each) for each in histories if len(each)
        ]
        if own:
            drawn[name] = sorted(own, key=lambda line: float(line[0].max()))
    if not drawn:
        return 0.0, {}
    largest = {name: float(own[-1][0].max()) for name, own in drawn.items()}
    top = min(max(largest.values()), _TALLEST * float(np.median(list(largest.values())))) or 1.0
    return top, {
        name: {"largest": largest[name], "lidar": own[-1][1].lidar, "paths": _lines(own, top)}
        for name, own in drawn.items()
    }


def _lines(own: Sequence[tuple[FloatArray, LidarSeries]], top: float) -> list[tuple[str, bool]]:
    axis = TimeAxis.around(np.concatenate([series.time_ns for _, series in own]), 0.0, LINE_WIDTH_PX)
    paths = []
    for values, series in own:
        height_px = (LINE_HEIGHT_PX - 2 * _LINE_MARGIN_PX) * np.minimum(values / top, 1.0)
        places = np.column_stack([axis.place(series.time_ns), LINE_HEIGHT_PX - _LINE_MARGIN_PX - height_px])
        paths.append((_path(places) + ("h0" if len(places) == 1 else ""), series is own[-1][1]))
    return paths
