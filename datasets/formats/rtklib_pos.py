"""RTKLIB solution files (``.pos``): positions, and velocities where they were written.

The comment line that names the columns says everything: time system (GPST or UTC), geodetic
(degrees, or degrees, minutes and seconds in three tokens) or ECEF, which deviations follow, the
velocity (north-east-up or ECEF), and the character between fields. Time is a calendar date or
week and seconds of week. The off-diagonal columns (sdne, sdeu, sdun; sdxy, sdyz, sdzx) are signed
roots: the covariance is sd·|sd|.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...filters.earth import C_en_at, ecef_to_lla, lla_to_ecef
from ...filters.errors import DataError
from ...filters.rotation import FloatArray
from .. import gpstime
from ..fields import StrArray
from ..observations import GnssFixes
from ..text.tables import Table, increasing, read_lines, read_table

#: RTKLIB's solution status, column Q.
QUALITY = {1: "fixed", 2: "float", 3: "sbas", 4: "dgps", 5: "single", 6: "ppp", 7: "dr"}
_GEODETIC = ("latitude(deg)", "longitude(deg)", "height(m)")
_SEXAGESIMAL = ("latitude(d'\")", "longitude(d'\")", "height(m)")
_ECEF = ("x-ecef(m)", "y-ecef(m)", "z-ecef(m)")
_VELOCITIES = ({"vn", "ve", "vu"}, {"vx", "vy", "vz"})
_TIME_SYSTEMS = ("GPST", "UTC")


def is_pos(path: Path) -> bool:
    """Return whether a file names RTKLIB's solution columns in its first lines."""
    with path.open(encoding="utf-8", errors="replace") as stream:
        head = [stream.readline() for _ in range(60)]
    return _header(head) is not None


def read_pos(path: str | Path, lines: list[str] | None = None) -> GnssFixes:
    """Return the fixes of an RTKLIB solution file.

    Parameters
    ----------
    path : path
    lines : list of str, optional
        Its lines, where the caller has read them already.

    Raises
    ------
    DataError
        No column header, baselines instead of coordinates, a height above the geoid, an unknown
        time system, unreadable rows, time not increasing.
    """
    path = Path(path)
    lines = read_lines(path) if lines is None else lines
    found = _header(lines[:200])
    if found is None:
        raise DataError(
            "no column header ('%  GPST  latitude(deg) …') found",
            file=path,
            remedy="write the solution with out-outhead=on",
        )
    line, system, names = found
    _check_header(path, lines[: line + 1], line, system, names)
    separator = next((c for c in ",;\t" if c in lines[line]), "")
    if separator:
        lines = [text.replace(separator, " ") for text in lines]
    names = _tokens(names)
    columns = ("date or week", "time", *names)
    table = read_table(
        path,
        columns,
        numeric=range(2, len(columns)),
        text=(0, 1),
        lines=lines,
        is_data=lambda token: token[:1].isdigit(),
    )
    value = {name.split("(")[0]: table.values[:, k] for k, name in enumerate(names)}
    _join_sexagesimal(table, value)
    time = _time(table, system)
    increasing(table, time, "time")
    quality = np.array([QUALITY.get(int(q), f"Q={int(q)}") for q in value["Q"]])
    if "latitude" in value:
        return _geodetic_fixes(time, value, quality)
    return _ecef_fixes(time, value, quality)


def _header(lines: list[str]) -> tuple[int, str, list[str]] | None:
    """Return index of the column header, its time system and the names after the time."""
    for k, line in enumerate(lines):
        tokens = re.split(r"[\s,;]+", line.strip())
        if tokens[:1] == ["%"]:
            tokens = tokens[1:]
        elif line.startswith("%"):
            tokens[0] = tokens[0][1:]
        else:
            continue
        if "Q" in tokens and "ns" in tokens:
            return k, tokens[0], tokens[1:]
    return None


def _check_header(path: Path, head: list[str], line: int, system: str, names: list[str]) -> None:
    def refuse(problem: str, remedy: str) -> None:
        raise DataError(problem, file=path, line=line + 1, remedy=remedy)

    if system not in _TIME_SYSTEMS:
        refuse(f"time system: expected GPST or UTC, found {system}", "set out-timesys=gpst")
    if not any(set(kind) <= set(names) for kind in (_GEODETIC, _SEXAGESIMAL, _ECEF)):
        refuse(
            f"expected {' '.join(_GEODETIC)} or {' '.join(_ECEF)}, found {' '.join(names[:3])}",
            "set out-solformat=llh or xyz",
        )
    known = {name.split("(")[0] for name in names}
    if known & {v for kind in _VELOCITIES for v in kind} and not any(
        kind <= known for kind in _VELOCITIES
    ):
        refuse("velocity: expected vn ve vu or vx vy vz", "set out-outvel=on")
    if any("/geodetic" in comment for comment in head):
        refuse("heights are above the geoid", "set out-height=ellipsoidal")


def _tokens(names: list[str]) -> list[str]:
    """Return one name per token: degrees, minutes and seconds are three."""
    out = []
    for name in names:
        what, _, unit = name.partition("(")
        out += [f"{what} {part}" for part in "dms"] if unit.startswith("d'") else [name]
    return out


def _join_sexagesimal(table: Table, value: dict[str, FloatArray]) -> None:
    """Add latitude and longitude [deg] where the file has degrees, minutes and seconds.

    The sign stands at the degrees alone, also before a zero: −0° 30′ is south.
    """
    for what in ("latitude", "longitude"):
        if f"{what} d" not in value:
            continue
        degrees, minutes, seconds = (value[f"{what} {part}"] for part in "dms")
        bad = (minutes < 0.0) | (minutes >= 60.0) | (seconds < 0.0) | (seconds > 60.0)
        if bad.any():
            k = int(np.argmax(bad))
            raise DataError(
                f"{what}: expected minutes and seconds of 0 … 60, found {minutes[k]:g} "
                f"{seconds[k]:g}",
                file=table.file,
                line=int(table.line[k]),
            )
        size = np.abs(degrees) + minutes / 60.0 + seconds / 3600.0
        value[what] = np.copysign(size, degrees)


def _time(table: Table, system: str) -> FloatArray:
    """Return GPS time from calendar date and time of day, or from week and seconds of week."""
    import pandas as pd

    first, second = table.text
    if "/" in str(first[0]):
        form = "%Y/%m/%d %H:%M:%S.%f" if "." in str(second[0]) else "%Y/%m/%d %H:%M:%S"
        stamps = pd.to_datetime(
            pd.Series(first) + " " + pd.Series(second), format=form, errors="coerce"
        )
        _all_read(table, stamps.isna().to_numpy(), "2024/05/01 12:00:00.000")
        time = (stamps - pd.Timestamp("1980-01-06")).dt.total_seconds().to_numpy()
    else:
        week, sow = (
            pd.to_numeric(pd.Series(c), errors="coerce").to_numpy() for c in (first, second)
        )
        _all_read(table, ~np.isfinite(week + sow), "2300 345600.000")
        time = gpstime.from_week_sow(week, sow)
    if system == "UTC":  # a calendar date in UTC: Unix time, then with the leap seconds
        unix_of_epoch = pd.Timestamp("1980-01-06").timestamp()
        time = gpstime.from_unix(time + unix_of_epoch)
    return time


def _all_read(table: Table, bad: NDArray[np.bool_], example: str) -> None:
    if bad.any():
        k = int(np.argmax(bad))
        raise DataError(
            f"time: expected as '{example}', found '{table.text[0][k]} {table.text[1][k]}'",
            file=table.file,
            line=int(table.line[k]),
        )


def _signed_square(value: FloatArray) -> FloatArray:
    return value * np.abs(value)


def _covariance(value: dict[str, FloatArray], kind: str, axes: str) -> FloatArray:
    """Return covariances in the axes' order; NaN where the file has no deviations.

    `kind` is 'sd' for position and 'sdv' for velocity, `axes` is 'neu' or 'xyz'; RTKLIB writes
    the pairs 12, 23, 31.
    """
    n = next(iter(value.values())).size
    out = np.full((n, 3, 3), np.nan)
    if not all(f"{kind}{a}" in value for a in axes):
        return out
    for i, a in enumerate(axes):
        out[:, i, i] = value[f"{kind}{a}"] ** 2
        j = (i + 1) % 3
        pair = value.get(f"{kind}{a}{axes[j]}")
        out[:, i, j] = out[:, j, i] = 0.0 if pair is None else _signed_square(pair)
    return out


def _geodetic_fixes(time: FloatArray, value: dict[str, FloatArray], quality: StrArray) -> GnssFixes:
    lat, lon = np.radians(value["latitude"]), np.radians(value["longitude"])
    C_e_neu = _C_e_neu(lat, lon)
    vel_e, vel_cov_e = _velocity(value, C_e_neu)
    return GnssFixes(
        time=time,
        pos_e=lla_to_ecef(lat, lon, value["height"]),
        pos_cov_e=_turned(C_e_neu, _covariance(value, "sd", "neu")),
        vel_e=vel_e,
        vel_cov_e=vel_cov_e,
        satellites=value["ns"].astype(int),
        quality=quality,
    )


def _ecef_fixes(time: FloatArray, value: dict[str, FloatArray], quality: StrArray) -> GnssFixes:
    pos_e = _vector(value, ("x-ecef", "y-ecef", "z-ecef"), time.size)
    lla = ecef_to_lla(pos_e)
    vel_e, vel_cov_e = _velocity(value, _C_e_neu(lla[:, 0], lla[:, 1]))
    return GnssFixes(
        time=time,
        pos_e=pos_e,
        pos_cov_e=_covariance(value, "sd", "xyz"),
        vel_e=vel_e,
        vel_cov_e=vel_cov_e,
        satellites=value["ns"].astype(int),
        quality=quality,
    )


def _C_e_neu(lat: FloatArray, lon: FloatArray) -> FloatArray:
    """Return the rotation from RTKLIB's axes north, east, up to ECEF."""
    return C_en_at(lat, lon) * np.array([1.0, 1.0, -1.0])


def _turned(C: FloatArray, cov: FloatArray) -> FloatArray:
    return C @ cov @ np.swapaxes(C, 1, 2)


def _velocity(value: dict[str, FloatArray], C_e_neu: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return velocity and covariance in ECEF, whichever axes the file has them in."""
    n = C_e_neu.shape[0]
    if {"vx", "vy", "vz"} <= set(value):
        return _vector(value, ("vx", "vy", "vz"), n), _covariance(value, "sdv", "xyz")
    vel = _vector(value, ("vn", "ve", "vu"), n)
    return np.einsum("nij,nj->ni", C_e_neu, vel), _turned(C_e_neu, _covariance(value, "sdv", "neu"))


def _vector(value: dict[str, FloatArray], names: tuple[str, str, str], n: int) -> FloatArray:
    if not all(name in value for name in names):
        return np.full((n, 3), np.nan)
    return np.column_stack([value[name] for name in names])
