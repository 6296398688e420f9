"""GPS time as seconds since the GPS epoch (1980-01-06 00:00:00), float64, no leap seconds.

float64 resolves 0.24 µs at today's 1.4e9 s: 7 µm at 30 m/s.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import numpy as np
from numpy.typing import ArrayLike, NDArray

SECONDS_PER_WEEK = 604800.0
_GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)

# UTC instants from which GPS − UTC has the given value (IERS Bulletin C; none since 2017).
_LEAP_SECONDS = [
    (datetime(1981, 7, 1, tzinfo=UTC), 1), (datetime(1982, 7, 1, tzinfo=UTC), 2),
    (datetime(1983, 7, 1, tzinfo=UTC), 3), (datetime(1985, 7, 1, tzinfo=UTC), 4),
    (datetime(1988, 1, 1, tzinfo=UTC), 5), (datetime(1990, 1, 1, tzinfo=UTC), 6),
    (datetime(1991, 1, 1, tzinfo=UTC), 7), (datetime(1992, 7, 1, tzinfo=UTC), 8),
    (datetime(1993, 7, 1, tzinfo=UTC), 9), (datetime(1994, 7, 1, tzinfo=UTC), 10),
    (datetime(1996, 1, 1, tzinfo=UTC), 11), (datetime(1997, 7, 1, tzinfo=UTC), 12),
    (datetime(1999, 1, 1, tzinfo=UTC), 13), (datetime(2006, 1, 1, tzinfo=UTC), 14),
    (datetime(2009, 1, 1, tzinfo=UTC), 15), (datetime(2012, 7, 1, tzinfo=UTC), 16),
    (datetime(2015, 7, 1, tzinfo=UTC), 17), (datetime(2017, 1, 1, tzinfo=UTC), 18),
]  # fmt: skip
_LEAP_UNIX = np.array([start.timestamp() for start, _ in _LEAP_SECONDS])
_LEAP_COUNT = np.array([0] + [count for _, count in _LEAP_SECONDS], dtype=float)


def from_week_sow(week: ArrayLike, sow: ArrayLike) -> NDArray[np.float64]:
    """Return GPS time [s] from GPS week and seconds of week."""
    return np.asarray(week, dtype=float) * SECONDS_PER_WEEK + np.asarray(sow, dtype=float)


def to_week_sow(time: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return GPS week and seconds of week of GPS time [s]."""
    t = np.asarray(time, dtype=float)
    week = np.floor(t / SECONDS_PER_WEEK)
    return week.astype(np.int64), t - week * SECONDS_PER_WEEK


def from_unix(unix: ArrayLike) -> NDArray[np.float64]:
    """Return GPS time [s] from Unix time (UTC) [s], with the leap seconds of that instant."""
    u = np.asarray(unix, dtype=float)
    leap = _LEAP_COUNT[np.searchsorted(_LEAP_UNIX, u, side="right")]
    return u - _GPS_EPOCH.timestamp() + leap


def gps_minus_utc(time: float) -> float:
    """Return GPS − UTC at GPS time [s]: the leap seconds since 1980."""
    at = _LEAP_UNIX - _GPS_EPOCH.timestamp() + _LEAP_COUNT[1:]
    return float(_LEAP_COUNT[np.searchsorted(at, time, side="right")])


def from_calendar(year: int, month: int, day: int, hour=0, minute=0, second=0.0) -> float:
    """Return GPS time [s] from a calendar date in GPS time (as RINEX and RTKLIB print it)."""
    start = datetime(year, month, day, hour, minute, tzinfo=UTC)
    return (start - _GPS_EPOCH).total_seconds() + float(second)


def to_calendar(time: float) -> datetime:
    """Return the calendar date in GPS time (not UTC), without a time zone, to the microsecond."""
    return (_GPS_EPOCH + timedelta(seconds=float(time))).replace(tzinfo=None)
