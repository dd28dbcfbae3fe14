# SPDX-License-Identifier: Apache-2.0
"""Axis of time with ticks at calendar days, months or years."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from multilica.geometry import FloatArray

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
