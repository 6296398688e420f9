"""From the time column of a file, in its declared scale, to GPS time.

A scale is never guessed: 18 s between GPS and UTC, and any number of weeks, look alike in a
column of numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..filters.errors import DataError
from ..filters.rotation import FloatArray
from . import gpstime
from .text.tables import Table

#: Time scales by name, and what a column in them holds.
SCALES = {
    "gps": "seconds since the GPS epoch, 1980-01-06",
    "gps-sow": "GPS seconds of week; needs week = N",
    "gps-week-sow": "two columns, GPS week and seconds of week",
    "gps-calendar": "date and time of day in GPS time",
    "utc": "date and time of day in UTC",
    "unix": "seconds since 1970-01-01 UTC",
    "relative": "seconds from any start, the same for all files; no date",
}
UNITS = {"s": 1.0, "ms": 1e-3, "100us": 1e-4, "us": 1e-6, "ns": 1e-9}
_CALENDAR = ("gps-calendar", "utc")
#: A logger's week number is late by less than this [s].
_LATE = 60.0
# Plausible numbers per scale: 1980 … 2100, or one week and a day.
_LIMITS = {
    "gps": (1e8, 3.8e9),
    "gps-sow": (0.0, gpstime.SECONDS_PER_WEEK + 86400.0),
    "unix": (315964800.0, 4.1e9),
}


@dataclass(frozen=True)
class TimeScale:
    """How one file counts time.

    Parameters
    ----------
    name : str
        One of `SCALES`.
    week : int, optional
        GPS week of the first row, for 'gps-sow'.
    unit : {'s', 'ms', '100us', 'us', 'ns'}
    offset : float
        Added to the file's stamps [s]: a correction, or the start of a clock that counts from it.
    rate : float, optional
        Rows a second, for stamps that have been rounded; see `evenly_spaced`.
    """

    name: str
    week: int | None = None
    unit: str = "s"
    offset: float = 0.0
    rate: float | None = None

    @property
    def is_text(self) -> bool:
        """Whether the columns hold dates, not numbers."""
        return self.name in _CALENDAR

    @property
    def is_relative(self) -> bool:
        """Whether there is no date."""
        return self.name == "relative"


def gps_time(table: Table, scale: TimeScale, numbers: FloatArray, text: list[str]) -> FloatArray:
    """Return GPS time [s] of the rows of a table ('relative': seconds as they are).

    Parameters
    ----------
    table : Table
        Where the columns come from, for the message.
    scale : TimeScale
    numbers : ndarray, shape (n, m)
        The time columns of a numeric scale.
    text : list of str
        The time columns of a calendar scale, joined by a space.

    Raises
    ------
    DataError
        Stamps that cannot be in this scale, with the line.
    """
    if scale.is_text:
        time = _calendar(table, text, scale.name)
    elif scale.name == "gps-week-sow":
        _within(table, "GPS week", numbers[:, 0], 0.0, 9999.0, "gps-sow needs one column only")
        numbers = numbers * [1.0, UNITS[scale.unit]]
        _within(table, "seconds of week", numbers[:, 1], *_LIMITS["gps-sow"], "columns exchanged?")
        time = gpstime.from_week_sow(numbers[:, 0] + late_weeks(numbers), numbers[:, 1])
    else:
        seconds = numbers[:, 0] * UNITS[scale.unit] + scale.offset
        if scale.name in _LIMITS:
            other = _other_scale(seconds)
            _within(table, f"{scale.name} time", seconds, *_LIMITS[scale.name], other)
        time = seconds
        if scale.name == "unix":
            time = gpstime.from_unix(seconds)
        elif scale.name == "gps-sow":
            assert scale.week is not None
            rollover = np.diff(seconds, prepend=seconds[0]) < -gpstime.SECONDS_PER_WEEK / 2
            time = gpstime.from_week_sow(scale.week + np.cumsum(rollover), seconds)
        return time
    return time + scale.offset


def late_weeks(week_and_sow: FloatArray) -> FloatArray:
    """Return what to add to week numbers that change before or after the seconds of week do.

    Week and seconds come from two tasks of a logger; at the end of a week one of them is late. A
    row is mended where its week is one off from that of the others counted on, and its seconds
    are within a minute of the week's end; otherwise nothing is touched.

    Parameters
    ----------
    week_and_sow : ndarray, shape (n, 2)

    Returns
    -------
    ndarray, shape (n,)
        Zero but for the rows to mend.
    """
    week, sow = week_and_sow.T
    ends = np.cumsum(np.diff(sow, prepend=sow[:1]) < -gpstime.SECONDS_PER_WEEK / 2)
    counted = week - ends
    off = float(np.median(counted)) - counted
    late = (off == 1.0) & (sow < _LATE)
    early = (off == -1.0) & (sow > gpstime.SECONDS_PER_WEEK - _LATE)
    return off if ((off == 0.0) | late | early).all() else np.zeros(week.size)


def evenly_spaced(table: Table, time: FloatArray, rate: float) -> FloatArray:
    """Return times at an even rate in place of rounded stamps, which must agree with them.

    Parameters
    ----------
    table : Table
        Where the stamps come from, for the message.
    time : ndarray, shape (n,)
        Rounded to the nearest, never decreasing [s].
    rate : float
        Rows a second [Hz].

    Raises
    ------
    DataError
        A stamp further than their resolution from its even time: lost rows, or another rate.
    """
    step = np.diff(time)
    if not (step > 0.0).any() or step.min() < 0.0:
        return time  # for `increasing` to refuse
    resolution = float(np.median(step[step > 0.0]))
    even = np.arange(time.size) / rate
    late = time - even
    first = 0.5 * float(late.min() + late.max())
    bad = np.abs(late - first) > 0.5 * resolution + 1.0 / rate
    if bad.any():
        k = int(np.argmax(bad))
        own = (time.size - 1) / (time[-1] - time[0])
        raise DataError(
            f"time: expected rows at {rate:g} Hz (rate_hz), found {time[k]:.10g}, "
            f"{abs(late[k] - first):.3g} s from the even time of this row",
            file=table.file,
            line=int(table.line[k]),
            remedy=f"rows are missing, or the rate is another (on average {own:.6g} Hz)",
        )
    return first + even


def _within(
    table: Table, what: str, value: FloatArray, low: float, high: float, remedy: str
) -> None:
    bad = ~((value >= low) & (value <= high))
    if bad.any():
        k = int(np.argmax(bad))
        raise DataError(
            f"{what}: expected {low:.10g} … {high:.10g}, found {value[k]:.10g}",
            file=table.file,
            line=int(table.line[k]),
            remedy=remedy,
        )


def _other_scale(seconds: FloatArray) -> str:
    """Return which scales and units the median of such numbers would fit."""
    middle = float(np.median(seconds))
    fits = [
        f'time_scale = "{name}"' + ("" if unit == "s" else f', time_unit = "{unit}"')
        for name, (low, high) in _LIMITS.items()
        for unit, factor in UNITS.items()
        if low <= middle * factor <= high and (name != "gps-sow" or unit in ("s", "ms"))
    ]
    return ("such numbers would fit " + " or ".join(fits)) if fits else "declare time_scale anew"


def _calendar(table: Table, text: list[str], name: str) -> FloatArray:
    """Return GPS time of calendar dates; an explicit offset from UTC is honoured."""
    import pandas as pd

    epoch = pd.Timestamp("1980-01-06")
    cleaned = pd.Series(text, dtype=str).str.replace("/", "-", regex=False)
    stamps = pd.to_datetime(cleaned, format="ISO8601", utc=True, errors="coerce")
    bad: NDArray[np.bool_] = stamps.isna().to_numpy()
    if bad.any():
        k = int(np.argmax(bad))
        raise DataError(
            f"time: expected a date such as '2025-07-08 19:34:18.500', found '{text[k]}'",
            file=table.file,
            line=int(table.line[k]),
        )
    seconds = (stamps - epoch.tz_localize("UTC")).dt.total_seconds().to_numpy()
    if name == "gps-calendar":
        return seconds
    return gpstime.from_unix(seconds + epoch.timestamp())
