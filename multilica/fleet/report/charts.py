# SPDX-License-Identifier: Apache-2.0
"""Geometry of the charts of poses over time: plots of a LiDAR, and small lines of a vehicle; in SVG pixels."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from multilica.fleet.drift.findings import Finding
from multilica.fleet.lidar_series import LidarSeries
from multilica.fleet.times import day_of
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


@dataclass(frozen=True, slots=True, eq=False)
class LidarHistory:
    """A series with its offsets (N, 6) from its median and their standard deviations, in mm and degrees."""

    series: LidarSeries
    offsets: FloatArray
    sigmas: FloatArray

    @classmethod
    def of(cls, series: LidarSeries) -> LidarHistory:
        """Compute the offsets of a series."""
        return cls(series, series.offsets_from_median(), series.sigmas())

    @property
    def distances_mm(self) -> FloatArray:
        """(N,) distances to the median position."""
        return np.asarray(np.linalg.norm(self.offsets[:, :3], axis=1))

    @property
    def angles_deg(self) -> FloatArray:
        """(N,) angles to the median rotation."""
        return np.asarray(np.linalg.norm(self.offsets[:, 3:], axis=1))


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


@dataclass(frozen=True, slots=True)
class PlotStrip:
    """One component over time, as path data; `ticks` are rows and labels."""

    name: str
    top: float
    ticks: tuple[tuple[float, str], ...]
    band: str
    line: str
    rings: str
    diamonds: str


@dataclass(frozen=True, slots=True)
class PlotSpan:
    """An event: from where to where, its line, and its label."""

    kind: str
    left: float
    width: float
    line: float
    label: str
    label_x: float
    label_y: float


@dataclass(frozen=True, slots=True)
class DriftPlot:
    """Three strips with one axis of time.

    Args:
        months: columns and labels of the ticks.
        logs: left edge, width and text of the area of each log with a pose.
        missing: columns of the logs without a pose.
    """

    title: str
    unit: str
    summary: str
    top: float
    bottom: float
    strips: tuple[PlotStrip, ...]
    spans: tuple[PlotSpan, ...]
    months: list[tuple[float, str]]
    logs: tuple[tuple[float, float, str], ...]
    missing: list[float]


def number(value: float, digits: int = 1) -> str:
    """Return a number without trailing zeros."""
    text = f"{value:z.{digits}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def drift_plots(history: LidarHistory, events: Sequence[Finding], *, texts: bool) -> list[DriftPlot]:
    """Return the plots of translation and rotation; none for a LiDAR that never had a pose at a known time.

    Args:
        events: of this LiDAR.
        texts: tell date and values of each log where the pointer rests.
    """
    series = history.series
    if not len(series):
        return []
    periods = [(event, period) for event in events if (period := event.period_ns) is not None]
    bounds_ns = np.array([bound for _, period in periods for bound in period], dtype=np.int64)
    axis = TimeAxis.around(np.concatenate([series.time_ns, series.missing_ns, bounds_ns]), LEFT_PX, RIGHT_PX)
    spans, rows = _spans(periods, axis)
    top = 6.0 + rows * _LABEL_ROW_PX
    return [_plot(history, axis, index, spans, top, texts=texts) for index in range(len(_QUANTITIES))]


def _plot(
    history: LidarHistory, axis: TimeAxis, index: int, spans: tuple[PlotSpan, ...], top: float, *, texts: bool
) -> DriftPlot:
    title, unit, names, least, digits = _QUANTITIES[index]
    series = history.series
    offsets, sigmas = (each[:, 3 * index : 3 * index + 3] for each in (history.offsets, history.sigmas))
    limit = _half_range(offsets, sigmas, least)
    columns = axis.place(series.time_ns)
    calibrated = np.isin(np.arange(len(series)), list(series.calibrated))
    strips = tuple(
        _strip(name, columns, offsets[:, i], sigmas[:, i], limit, calibrated, top + i * (STRIP_PX + _GAP_PX))
        for i, name in enumerate(names)
    )
    sizes = np.linalg.norm(offsets, axis=1)
    worst = int(np.argmax(sizes))
    return DriftPlot(
        title,
        unit,
        f"{series.lidar}, {title}: at most {sizes[worst]:.{digits}f} {unit} from the median, "
        f"on {day_of(int(series.time_ns[worst]))}",
        top,
        top + 3 * STRIP_PX + 2 * _GAP_PX,
        strips,
        spans,
        axis.ticks(),
        _areas(series, columns, offsets, sigmas, index) if texts else (),
        axis.place(series.missing_ns).tolist(),
    )


def _half_range(offsets: FloatArray, sigmas: FloatArray, least: float) -> float:
    """Return the half range of an axis: all offsets, and nearly all of their bands."""
    bands = np.abs(offsets) + np.nan_to_num(sigmas)
    return max(least, 1.1 * float(np.abs(offsets).max()), 1.05 * float(np.quantile(bands, _NEARLY_ALL)))


def _strip(
    name: str,
    columns: FloatArray,
    offsets: FloatArray,
    sigmas: FloatArray,
    limit: float,
    calibrated: npt.NDArray[np.bool_],
    top: float,
) -> PlotStrip:
    def row(values: npt.ArrayLike) -> FloatArray:
        return np.asarray(top + STRIP_PX * (0.5 - np.clip(np.divide(values, limit), -1.0, 1.0) / 2.0))

    tick = _nice_below(0.85 * limit)
    places = np.column_stack([columns, row(offsets)])
    return PlotStrip(
        name,
        top,
        tuple((float(row(at)), _signed(at)) for at in (tick, 0.0, -tick)),
        _band(columns, row(offsets + sigmas), row(offsets - sigmas), np.isfinite(sigmas)),
        _path(places),
        _marks(places[~calibrated], *_RING),
        _marks(places[calibrated], *_DIAMOND),
    )


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


def _spans(periods: Sequence[tuple[Finding, tuple[int, int]]], axis: TimeAxis) -> tuple[tuple[PlotSpan, ...], int]:
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
        label_y = _LABEL_ROW_PX * (row + 1) - 2.0
        spans.append(PlotSpan(event.kind, left, max(right - left, 1.0), line, label, centre, label_y))
    return tuple(spans), len(ends_px)


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


def _signed(value: float) -> str:
    return "0" if value == 0.0 else f"{value:+g}".replace("-", "\u2212")


@dataclass(frozen=True, slots=True)
class Sparkline:
    """Small lines of a vehicle.

    Args:
        largest, lidar: the largest value, and whose it is.
        paths: per LiDAR its path data and whether it is the one with the largest value, which comes last.
    """

    largest: float
    lidar: str
    paths: tuple[tuple[str, bool], ...]


def sparklines(
    vehicles: Mapping[str, Sequence[LidarHistory]], values: Callable[[LidarHistory], FloatArray]
) -> tuple[float, dict[str, Sparkline]]:
    """Draw the values (N,) of each history of each vehicle, all with one scale from zero to the value returned."""
    drawn = {
        name: sorted((each for each in own if len(each.series)), key=lambda each: float(values(each).max()))
        for name, own in vehicles.items()
    }
    largest = {name: float(values(own[-1]).max()) for name, own in drawn.items() if own}
    if not largest:
        return 0.0, {}
    top = min(max(largest.values()), _TALLEST * float(np.median(list(largest.values())))) or 1.0
    return top, {name: Sparkline(size, *_lines(drawn[name], values, top)) for name, size in largest.items()}


def _lines(
    histories: Sequence[LidarHistory], values: Callable[[LidarHistory], FloatArray], top: float
) -> tuple[str, tuple[tuple[str, bool], ...]]:
    axis = TimeAxis.around(np.concatenate([each.series.time_ns for each in histories]), 0.0, LINE_WIDTH_PX)
    paths = []
    for each in histories:
        height_px = (LINE_HEIGHT_PX - 2 * _LINE_MARGIN_PX) * np.minimum(values(each) / top, 1.0)
        places = np.column_stack([axis.place(each.series.time_ns), LINE_HEIGHT_PX - _LINE_MARGIN_PX - height_px])
        paths.append((_path(places) + ("h0" if len(places) == 1 else ""), each is histories[-1]))
    return histories[-1].series.lidar, tuple(paths)
