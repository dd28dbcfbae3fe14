# SPDX-License-Identifier: Apache-2.0
"""Geometry of the drift plots: offsets of a LiDAR from its median pose over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from multilica.fleet.report.contents import EventKind, LidarHistory, PageEvent
from multilica.fleet.report.time_axis import TimeAxis, day_of
from multilica.geometry import FloatArray

_WIDTH_PX, _LEFT_PX, _RIGHT_PX = 470.0, 82.0, 8.0
_STRIP_PX, _GAP_PX, _BOTTOM_PX = 62.0, 13.0, 24.0
_LABEL_ROW_PX = 17.0
_LETTER_PX = 9.5
_RING_PX, _DIAMOND_PX = 3.4, 4.6
_NEARLY_ALL = 0.9
_QUANTITIES = (
    ("translation", "mm", ("x", "y", "z"), 12.0, 1),
    ("rotation", "deg", ("roll", "pitch", "yaw"), 0.12, 3),
)
"""Name, unit, components, least half range of an axis, and decimals.

The least range is 40 percent of what `fleet run` takes for no motion by default, so that noise looks small.
"""


@dataclass(frozen=True, slots=True)
class PlotStrip:
    """One component over time; attributes in SVG pixels and path data."""

    name: str
    top: str
    middle: str
    ticks: tuple[tuple[str, str], ...]
    band: str
    line: str
    rings: str
    diamonds: str


@dataclass(frozen=True, slots=True)
class PlotSpan:
    """An event: from where to where, its line, and its label."""

    kind: EventKind
    left: str
    width: str
    line: str
    label: str
    label_x: str
    label_y: str


@dataclass(frozen=True, slots=True)
class DriftPlot:
    """Three strips with one axis of time.

    Args:
        logs: left edge, width and text of the area of each log with a pose.
        missing: pixels of the logs without a pose.
    """

    title: str
    unit: str
    summary: str
    width: str
    height: str
    left: str
    right: str
    top: str
    bottom: str
    strip_height: str
    strips: tuple[PlotStrip, ...]
    spans: tuple[PlotSpan, ...]
    months: tuple[tuple[str, str], ...]
    logs: tuple[tuple[str, str, str], ...]
    missing: tuple[str, ...]


def number(value: float, digits: int = 1) -> str:
    """Return a number without trailing zeros."""
    text = f"{value:z.{digits}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def drift_plots(history: LidarHistory, events: Sequence[PageEvent], *, texts: bool) -> list[DriftPlot]:
    """Return the plots of translation and rotation; none for a LiDAR that never had a pose at a known time.

    Args:
        events: of this LiDAR.
        texts: tell date and values of each log where the pointer rests.
    """
    if not len(history.time_ns):
        return []
    dated = [event for event in events if event.begin_ns is not None and event.end_ns is not None]
    bounds_ns = [bound for event in dated for bound in (event.begin_ns, event.end_ns)]
    times_ns = np.concatenate([history.time_ns, history.missing_ns, np.array(bounds_ns, dtype=np.int64)])
    axis = TimeAxis.around(times_ns, _LEFT_PX, _WIDTH_PX - _RIGHT_PX)
    return [_plot(history, dated, axis, index, texts=texts) for index in range(len(_QUANTITIES))]


def _plot(history: LidarHistory, events: Sequence[PageEvent], axis: TimeAxis, index: int, *, texts: bool) -> DriftPlot:
    title, unit, names, least, digits = _QUANTITIES[index]
    offsets, sigmas = (each[:, 3 * index : 3 * index + 3] for each in (history.offsets, history.sigmas))
    spans, rows = _spans(events, axis)
    top = 6.0 + rows * _LABEL_ROW_PX
    limit = _half_range(offsets, sigmas, least)
    columns = axis.place(history.time_ns)
    strips = tuple(
        _strip(name, columns, offsets[:, i], sigmas[:, i], limit, history, top + i * (_STRIP_PX + _GAP_PX))
        for i, name in enumerate(names)
    )
    bottom = top + 3 * _STRIP_PX + 2 * _GAP_PX
    sizes = np.linalg.norm(offsets, axis=1)
    worst = int(np.argmax(sizes))
    return DriftPlot(
        title,
        unit,
        f"{history.lidar}, {title}: at most {sizes[worst]:.{digits}f} {unit} from the median, "
        f"on {day_of(int(history.time_ns[worst]))}",
        number(_WIDTH_PX),
        number(bottom + _BOTTOM_PX),
        number(_LEFT_PX),
        number(_WIDTH_PX - _RIGHT_PX),
        number(top),
        number(bottom),
        number(_STRIP_PX),
        strips,
        spans,
        tuple((number(x), label) for x, label in axis.ticks()),
        _areas(history, columns, offsets, sigmas, index) if texts else (),
        tuple(number(x) for x in axis.place(history.missing_ns)),
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
    history: LidarHistory,
    top_px: float,
) -> PlotStrip:
    def row(values: FloatArray) -> FloatArray:
        return np.asarray(top_px + _STRIP_PX * (0.5 - np.clip(values / limit, -1.0, 1.0) / 2.0))

    tick = _nice_below(0.85 * limit)
    places, known = np.column_stack([columns, row(offsets)]), np.isfinite(sigmas)
    return PlotStrip(
        name,
        number(top_px),
        number(top_px + _STRIP_PX / 2.0),
        tuple((number(float(row(np.array(at)))), _signed(at)) for at in (tick, 0.0, -tick)),
        _band(columns, row(offsets + sigmas), row(offsets - sigmas), known),
        "M" + " ".join(f"{number(x)} {number(y)}" for x, y in places),
        "".join(_ring(x, y) for x, y in places[~history.calibrated]),
        "".join(_diamond(x, y) for x, y in places[history.calibrated]),
    )


def _band(columns: FloatArray, upper: FloatArray, lower: FloatArray, known: npt.NDArray[np.bool_]) -> str:
    """Return an area per stretch of logs with known sigma; a bar for a log alone."""
    areas = []
    for stretch in np.split(np.arange(len(known)), np.flatnonzero(np.diff(known)) + 1):
        if not known[stretch[0]]:
            continue
        x, high, low = columns[stretch], upper[stretch], lower[stretch]
        if len(stretch) == 1:
            x, high, low = np.array([x[0] - 2.0, x[0] + 2.0]), np.repeat(high, 2), np.repeat(low, 2)
        outline = [*zip(x, high, strict=True), *zip(x[::-1], low[::-1], strict=True)]
        areas.append("M" + " ".join(f"{number(right)} {number(down)}" for right, down in outline) + "z")
    return "".join(areas)


def _ring(x: float, y: float) -> str:
    r, d = number(_RING_PX), number(2 * _RING_PX)
    return f"M{number(x - _RING_PX)} {number(y)}a{r} {r} 0 1 0 {d} 0a{r} {r} 0 1 0-{d} 0z"


def _diamond(x: float, y: float) -> str:
    d = number(_DIAMOND_PX)
    return f"M{number(x - _DIAMOND_PX)} {number(y)}l{d}-{d} {d} {d}-{d} {d}z"


def _spans(events: Sequence[PageEvent], axis: TimeAxis) -> tuple[tuple[PlotSpan, ...], int]:
    """Return the spans of events with labels that do not overlap, and the number of rows of labels."""
    spans, ends_px = [], list[float]()
    for event in sorted(events, key=lambda each: each.begin_ns or 0):
        left, right = (float(each) for each in axis.place([event.begin_ns or 0, event.end_ns or 0]))
        line = (left + right) / 2.0 if event.kind == "jump" else left
        label = f"{event.kind} {event.when}"
        half_px = _LETTER_PX * len(label) / 2.0
        centre = min(max(line, axis.left_px + half_px), axis.right_px - half_px)
        row = next((row for row, end in enumerate(ends_px) if end < centre - half_px), len(ends_px))
        ends_px[row : row + 1] = [centre + half_px]
        spans.append(
            PlotSpan(
                event.kind,
                number(left),
                number(max(right - left, 1.0)),
                number(line),
                label,
                number(centre),
                number(_LABEL_ROW_PX * (row + 1) - 2.0),
            )
        )
    return tuple(spans), len(ends_px)


def _areas(
    history: LidarHistory, columns: FloatArray, offsets: FloatArray, sigmas: FloatArray, index: int
) -> tuple[tuple[str, str, str], ...]:
    """Return left edge, width and text of the area of each log, between the middles to its neighbours."""
    _, unit, names, _, digits = _QUANTITIES[index]
    edges = np.concatenate([[_LEFT_PX], (columns[1:] + columns[:-1]) / 2.0, [_WIDTH_PX - _RIGHT_PX]])
    return tuple(
        (
            number(edges[i]),
            number(edges[i + 1] - edges[i]),
            f"{day_of(int(history.time_ns[i]))}, {'calibrated' if history.calibrated[i] else 'verified'}"
            f"{', uncertain' if history.uncertain[i] else ''}: "
            + ", ".join(
                f"{name} {value:+.{digits}f}{'' if math.isnan(sigma) else f' ± {sigma:.{digits}f}'} {unit}"
                for name, value, sigma in zip(names, offsets[i], sigmas[i], strict=True)
            )
            + f" ({history.sources[i]})",
        )
        for i in range(len(columns))
    )


def _nice_below(value: float) -> float:
    """Return the largest round number, of one digit or 15, that is not above a positive value."""
    power = 10.0 ** math.floor(math.log10(value))
    return power * next(
        step for step in (8.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.5, 1.0) if step <= value / power * (1.0 + 1e-9)
    )


def _signed(value: float) -> str:
    return "0" if value == 0.0 else f"{value:+g}".replace("-", "\u2212")
