"""Receivers' own logs: u-blox UBX (NAV-PVT) and NMEA 0183 (GGA with RMC, GST), as fixes.

Decoding is done by pyubx2 and pynmeagps (extra ``receivers``). UBX gives position, velocity and
accuracy estimates in one message and GPS time of week; NMEA gives UTC, heights above the geoid
with the separation beside them, and no vertical velocity, so that its velocities are left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import date, time, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from ...filters.earth import C_en_at, lla_to_ecef
from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray
from .. import gpstime
from ..observations import GnssFixes
from ..text.tables import cannot_open

_GPS_EPOCH_UNIX = 315964800.0
#: NMEA GGA quality.
_QUALITY = {1: "single", 2: "dgps", 3: "pps", 4: "fixed", 5: "float", 6: "dr"}
_DAY = 86400.0
_FIRST_DAY = date(1980, 1, 6)


def read_ubx(path: str | Path) -> tuple[GnssFixes, tuple[str, ...]]:
    """Return the NAV-PVT solutions of a UBX log.

    Parameters
    ----------
    path : path

    Returns
    -------
    fixes : GnssFixes
        3-D fixes with a valid date. The accuracy estimates hAcc and sAcc, which u-blox does not
        define further, are taken as 1σ of *each* axis they cover.
    notes : tuple of str

    Raises
    ------
    DataError
        No such message, or the package pyubx2 is not installed.
    """
    path = Path(path)
    damaged: list[str] = []
    rows, left_out = [], 0
    for m in _ubx_messages(path, damaged):
        if m.fixType not in (3, 4) or not (m.validDate and m.validTime and m.gnssFixOk):
            left_out += 1
            continue
        rows.append(
            (
                *(_epoch(m, path), m.lat, m.lon),
                *(1e-3 * v for v in (m.height, m.hAcc, m.vAcc)),
                *(1e-3 * v for v in (m.velN, m.velE, m.velD, m.sAcc)),
                *(m.numSV, getattr(m, "carrSoln", 0)),
            )
        )
    if not rows:
        raise DataError(
            f"no NAV-PVT message with a 3-D fix found ({left_out} without)",
            file=path,
            remedy="enable UBX-NAV-PVT in the receiver, or convert the raw data to RINEX",
        )
    value = np.array(rows, dtype=float)
    value = value[np.concatenate([[True], np.diff(value[:, 0]) > 0.0])]
    lat, lon = np.radians(value[:, 1:3]).T
    C_en = C_en_at(lat, lon)
    horizontal, vertical, speed = value[:, 4], value[:, 5], value[:, 9]
    words = np.array(["receiver", "float", "fixed"])
    fixes = GnssFixes(
        time=value[:, 0],
        pos_e=lla_to_ecef(lat, lon, value[:, 3]),
        pos_cov_e=_covariance(C_en, np.column_stack([horizontal, horizontal, vertical])),
        vel_e=np.einsum("nij,nj->ni", C_en, value[:, 6:9]),
        vel_cov_e=_covariance(C_en, np.column_stack([speed, speed, speed])),
        satellites=value[:, 10].astype(int),
        quality=words[np.clip(value[:, 11].astype(int), 0, 2)],
    )
    repeated = len(rows) - len(fixes)
    return fixes, (
        f"UBX NAV-PVT: {len(fixes)} fixes, {left_out} messages without a 3-D fix left out, "
        f"{repeated} repeated; hAcc and sAcc taken as 1σ of each axis" + _of_damaged(damaged),
    )


def _ubx_messages(path: Path, damaged: list[str]) -> Iterator[Any]:
    try:
        from pyubx2 import UBX_PROTOCOL, UBXReader
    except ImportError:
        raise _needs("pyubx2", path) from None
    with _open(path) as stream:
        reader = UBXReader(
            stream, protfilter=UBX_PROTOCOL, quitonerror=1,
            errorhandler=lambda error: damaged.append(str(error)),
        )  # fmt: skip
        for message in _decoded(reader, damaged):
            if message.identity == "NAV-PVT":
                yield message


def _epoch(m: Any, path: Path) -> float:
    """Return GPS time [s]: time of week as given, week from the UTC date."""
    try:
        utc = gpstime.from_calendar(m.year, m.month, m.day, m.hour, m.min, m.second)
    except ValueError:
        raise DataError(
            f"NAV-PVT: expected a date, found {m.year}-{m.month}-{m.day} {m.hour}:{m.min}, iTOW "
            f"{m.iTOW} ms",
            file=path,
            remedy="the log is damaged: copy it again, or cut the message out",
        ) from None
    near = float(gpstime.from_unix(utc + _GPS_EPOCH_UNIX))
    sow = m.iTOW * 1e-3
    week = round((near - sow) / gpstime.SECONDS_PER_WEEK)
    return float(gpstime.from_week_sow(week, sow))


def read_nmea(
    path: str | Path, *, position_sigma: FloatArray | None = None
) -> tuple[GnssFixes, tuple[str, ...]]:
    """Return the positions of an NMEA log.

    Parameters
    ----------
    path : path
    position_sigma : array_like, shape (1,) or (3,), optional
        1σ north, east, up [m] for positions without a GST sentence. Required if there are any.

    Returns
    -------
    fixes : GnssFixes
    notes : tuple of str

    Raises
    ------
    DataError
        No positions, no date (RMC or ZDA), or the package pynmeagps is not installed.
    ConfigError
        Positions without a deviation, and none declared.
    """
    path = Path(path)
    damaged: list[str] = []
    rows, deviations, without = _nmea_rows(path, damaged)
    if not rows:
        raise DataError(f"no GGA sentence with a fix found ({without} without)", file=path)
    value = np.array([row for _, row in sorted(rows.items())], dtype=float)
    sigma = np.array([deviations.get(time, (np.nan,) * 3) for time in sorted(rows)])
    bare = ~np.isfinite(sigma).all(axis=1)
    if bare.any():
        if position_sigma is None:
            raise ConfigError(
                f"{path}: {int(bare.sum())} of {bare.size} positions come without GST — add under "
                "[gnss]: position_sigma_m = [2.0, 2.0, 4.0]"
            )
        sigma[bare] = position_sigma
    lat, lon = np.radians(value[:, 0:2]).T
    n = len(value)
    fixes = GnssFixes(
        time=gpstime.from_unix(np.array(sorted(rows))),
        pos_e=lla_to_ecef(lat, lon, value[:, 2]),
        pos_cov_e=_covariance(C_en_at(lat, lon), sigma),
        vel_e=np.full((n, 3), np.nan),
        vel_cov_e=np.full((n, 3, 3), np.nan),
        satellites=value[:, 3].astype(int),
        quality=np.array([_QUALITY.get(int(q), f"Q={int(q)}") for q in value[:, 4]]),
    )
    return fixes, (
        f"NMEA: {n} positions, {without} sentences without a fix left out; deviations of "
        f"{n - int(bare.sum())} from GST, of {int(bare.sum())} as declared; heights raised by the "
        "geoid separation of GGA; speed and course left out (no vertical velocity)"
        + _of_damaged(damaged),
    )


def _nmea_rows(
    path: Path, damaged: list[str]
) -> tuple[dict[float, tuple[float, ...]], dict[float, tuple[float, ...]], int]:
    """Return positions and deviations by Unix time, and the number of sentences without fix."""
    rows: dict[float, tuple[float, ...]] = {}
    deviations: dict[float, tuple[float, ...]] = {}
    waiting: list[Any] = []  # sentences before the first date
    without, clock = 0, _Calendar()
    for m in _nmea_messages(path, damaged):
        if not isinstance(getattr(m, "time", None), time):
            continue  # another sentence, or one without the time of day
        if m.msgID in ("RMC", "ZDA"):
            day = getattr(m, "date", None) if m.msgID == "RMC" else _zda_date(m)
            if isinstance(day, date) and day >= _FIRST_DAY:
                clock.set(day, _time_of_day(m))
        elif m.msgID in ("GGA", "GST"):
            waiting.append(m)
        if not clock.known:
            continue
        for sentence in waiting:
            at = clock.unix(_time_of_day(sentence))
            if sentence.msgID == "GST":
                values = [getattr(sentence, k, "") for k in ("stdLat", "stdLong", "stdAlt")]
                if all(isinstance(v, int | float) and v > 0 for v in values):
                    deviations[at] = tuple(float(v) for v in values)
            elif not getattr(sentence, "quality", 0) or not _complete(sentence):
                without += 1
            else:
                height = float(sentence.alt) + float(sentence.sep)
                rows[at] = (sentence.lat, sentence.lon, height, sentence.numSV, sentence.quality)
        waiting.clear()
    if waiting and not rows:
        raise DataError(
            "no date found (RMC or ZDA sentence)", file=path, remedy="enable RMC in the receiver"
        )
    return rows, deviations, without


def _complete(gga: Any) -> bool:
    """Return whether every field a position needs is a number (it may be empty)."""
    fields = [getattr(gga, key, "") for key in ("lat", "lon", "alt", "sep", "numSV")]
    return all(isinstance(v, int | float) and math.isfinite(v) for v in fields)


def _zda_date(m: Any) -> date | None:
    try:
        return date(int(m.year), int(m.month), int(m.day))
    except (ValueError, TypeError, OverflowError, AttributeError):  # empty, missing, no such day
        return None


class _Calendar:
    """Date of the sentences: from RMC or ZDA, moved on where the time of day starts again."""

    def __init__(self) -> None:
        self.known = False
        self._day, self._time = date(1980, 1, 6), 0.0

    def set(self, day: date, time_of_day: float) -> None:
        self.known, self._day, self._time = True, day, time_of_day

    def unix(self, time_of_day: float) -> float:
        """Return Unix time: within half a day of the last dated sentence."""
        day = self._day
        if time_of_day < self._time - _DAY / 2:
            day += timedelta(days=1)
        elif time_of_day > self._time + _DAY / 2:
            day -= timedelta(days=1)
        seconds = gpstime.from_calendar(day.year, day.month, day.day) + time_of_day
        return seconds + _GPS_EPOCH_UNIX


def _time_of_day(m: Any) -> float:
    t = m.time
    return float(t.hour * 3600 + t.minute * 60 + t.second + t.microsecond * 1e-6)


def _nmea_messages(path: Path, damaged: list[str]) -> Iterator[Any]:
    try:
        from pynmeagps import NMEAReader
    except ImportError:
        raise _needs("pynmeagps", path) from None
    with _open(path) as stream:
        reader = NMEAReader(
            stream, quitonerror=1, errorhandler=lambda error: damaged.append(str(error))
        )
        yield from _decoded(reader, damaged)


def _decoded(reader: Any, damaged: list[str]) -> Iterator[Any]:
    """Yield the messages; what the decoder cannot read is told in `damaged`."""
    while True:
        try:
            _, message = next(reader)
        except StopIteration:
            return
        except (ValueError, TypeError, LookupError, AttributeError, ArithmeticError) as error:
            damaged.append(str(error))  # the decoder's own surprise: it goes on behind it
            continue
        if message is not None:
            yield message


def _of_damaged(damaged: list[str]) -> str:
    return f"; {len(damaged)} damaged messages left out" if damaged else ""


def _open(path: Path) -> Any:
    try:
        return path.open("rb")
    except OSError as error:
        raise cannot_open(path, error) from None


def _needs(package: str, path: Path) -> DataError:
    return DataError(
        f"reading this log needs the package {package}",
        file=path,
        remedy="pip install 'certnav[receivers]'",
    )


def _covariance(C_en: FloatArray, sigma: FloatArray) -> FloatArray:
    """Return covariances in ECEF of deviations north, east, down."""
    return np.einsum("nij,nj,nkj->nik", C_en, sigma**2, C_en)
