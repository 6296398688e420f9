"""Reference trajectories exported by Inertial Explorer as text.

What a file holds is in its header, two lines of names and units, with or without ``%``/``#``
before them: week (also printed as 2179.00000), GPS seconds of week, ECEF position [m],
latitude and longitude in degrees, minutes and seconds — *three* tokens each, where the unit says
``(+/-D M S)`` — ellipsoidal height, ECEF velocity [m/s], and attitude [deg]: heading clockwise
from north, pitch nose up, roll right side down, which is roll-pitch-heading of a
forward-right-down body. With an ``Easting`` column everything after the height moves by three.
Files without ECEF columns, as public sets publish them, give their position by latitude,
longitude and ellipsoidal height, and their velocity by VEast, VNorth, VUp, or along the body's
axes (VelBdyX right, VelBdyY forward, VelBdyZ up), or not at all.
Without a header the layout of the 2020 GREAT files is assumed and then has to survive the
cross-checks: geodetic against ECEF position, and velocity against differenced position.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...filters.earth import C_en_of, lla_to_ecef
from ...filters.errors import DataError
from ...filters.rotation import FloatArray, matrix_from_rpy
from ..gpstime import from_week_sow
from ..series import Reference
from ..text.tables import Table, increasing, read_lines, read_table, sampling_note
from ..time_scales import late_weeks

#: A column by name, and the part of degrees, minutes, seconds.
_Column = Callable[..., FloatArray]
_END = "Errors/warnings:"
_POSITION = ("X-ECEF", "Y-ECEF", "Z-ECEF")
_VELOCITY = ("VX-ECEF", "VY-ECEF", "VZ-ECEF")
_ATTITUDE = ("Roll", "Pitch", "Heading")
_GEODETIC = ("Latitude", "Longitude", "H-Ell")
_LOCAL = ("VEast", "VNorth", "VUp")
_BODY = ("VelBdyX", "VelBdyY", "VelBdyZ")
_REQUIRED = ("Week", "GPSTime", *_ATTITUDE)
_KNOWN = (*_REQUIRED, *_POSITION, *_GEODETIC, *_VELOCITY, *_LOCAL, *_BODY)
_DMS = re.compile(r"d(eg)?[ ,:]*m(in)?[ ,:]*s(ec)?", re.IGNORECASE)
#: Tokens of a file without header (GREAT 2020, no Easting); D M S columns already expanded.
_LAYOUT_2020 = {
    "Week": 0,
    "GPSTime": 1,
    "X-ECEF": 2,
    "Y-ECEF": 3,
    "Z-ECEF": 4,
    "Latitude": 5,
    "Longitude": 8,
    "H-Ell": 11,
    "VX-ECEF": 12,
    "VY-ECEF": 13,
    "VZ-ECEF": 14,
    "Heading": 21,
    "Pitch": 22,
    "Roll": 23,
}
#: Differenced position and velocity may disagree by this, RMS [m/s] …
_VELOCITY_TOLERANCE = 0.5
#: … and geodetic and ECEF position by this, median [m].
_POSITION_TOLERANCE = 1.0
#: Differenced positions this close in time follow a car's velocity to 0.03 m/s [s].
_DIFFERENCED = 0.25


@dataclass(frozen=True)
class Layout:
    """Where the columns are.

    Attributes
    ----------
    token : dict of str to int
        First token of each named column.
    names : tuple of str
        One name per token, up to the last named column.
    degrees_only : bool
        Whether latitude and longitude are one token (decimal degrees) instead of three.
    from_header : bool
    position, velocity : tuple of str
        The columns these are taken from; velocity may be empty.
    """

    token: dict[str, int]
    names: tuple[str, ...]
    degrees_only: bool
    from_header: bool
    position: tuple[str, ...]
    velocity: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class ReferenceTable:
    """A reference file converted to SI: what `read_reference` puts on a point of the vehicle.

    Attributes
    ----------
    time : ndarray, shape (n,)
        GPS time [s].
    pos_e, vel_e : ndarray, shape (n, 3)
        [m], [m/s].
    rpy : ndarray, shape (n, 3)
        Roll, pitch, heading [rad].
    week : int
        GPS week of the first row.
    week_line : int
        Its line in the file.
    notes : tuple of str
    """

    time: FloatArray
    pos_e: FloatArray
    vel_e: FloatArray
    rpy: FloatArray
    week: int
    week_line: int
    notes: tuple[str, ...]


def dms_to_radians(degree: ArrayLike, minute: ArrayLike, second: ArrayLike) -> FloatArray:
    """Return an angle [rad] from degrees, minutes and seconds.

    The sign stands at the degrees and holds for all three, also for −0.
    """
    d = np.asarray(degree, dtype=float)
    size = np.abs(d) + np.asarray(minute, dtype=float) / 60 + np.asarray(second, dtype=float) / 3600
    return np.radians(np.where(np.signbit(d), -size, size))


def read_layout(lines: list[str], path: str | Path) -> Layout:
    """Return where the columns are, from the header line that contains ``GPSTime``.

    Raises
    ------
    DataError
        When the header lacks a required column.
    """
    head = next((k for k, line in enumerate(lines[:200]) if "gpstime" in line.lower()), None)
    if head is None:
        names = _expand(_LAYOUT_2020, (*_REQUIRED, *_POSITION, *_VELOCITY))
        return Layout(dict(_LAYOUT_2020), names, False, False, _POSITION, _VELOCITY)
    titles = lines[head].lstrip("%# \t").split()
    units = lines[head + 1] if head + 1 < len(lines) else ""
    degrees_only = not _DMS.search(units)
    if not any(c.isalpha() for c in units):  # no line of units: the first row tells
        degrees_only = len(units.split()) < len(titles) + 4
    canonical = {name.lower(): name for name in _KNOWN}
    token: dict[str, int] = {}
    at = 0
    for title in titles:
        name = canonical.get(title.lower(), title)
        token.setdefault(name, at)
        at += 3 if name in ("Latitude", "Longitude") and not degrees_only else 1

    def whole(columns: tuple[str, ...]) -> bool:
        return all(name in token for name in columns)

    missing = [name for name in _REQUIRED if name not in token]
    position = _POSITION if whole(_POSITION) else _GEODETIC
    if not whole(position):
        missing += [name for name in _POSITION if name not in token]
        missing[-1] += " (or Latitude, Longitude, H-Ell)"
    if missing:
        raise DataError(
            f"header lacks {', '.join(missing)} (found {' '.join(titles[:8])} …)",
            file=path,
            line=head + 1,
            remedy="export the reference with these columns, or declare it as a table of columns",
        )
    velocity = next((names for names in (_VELOCITY, _LOCAL, _BODY) if whole(names)), ())
    names = _expand(token, (*_REQUIRED, *position, *velocity), degrees_only)
    return Layout(token, names, degrees_only, True, position, velocity)


def _expand(
    token: dict[str, int], used: tuple[str, ...], degrees_only: bool = False
) -> tuple[str, ...]:
    """Return one name per token, up to the last used one."""
    last = max(
        token[name] + (2 if name in ("Latitude", "Longitude") and not degrees_only else 0)
        for name in used
    )
    names = [f"column {k + 1}" for k in range(last + 1)]
    for name, k in token.items():
        if k <= last:
            names[k] = name
    for name in ("Latitude", "Longitude"):
        k = token.get(name, last + 1)
        for part, label in enumerate(("D", "M", "S")):
            if k + part <= last and (part == 0 or names[k + part].startswith("column")):
                names[k + part] = f"{name} {label}"
    return tuple(names)


def read_reference_table(path: str | Path) -> ReferenceTable:
    """Read and cross-check an Inertial Explorer text export.

    Raises
    ------
    DataError
        Unreadable rows (with line), missing columns, time not increasing, and contradictions
        between ECEF and geodetic position or between position and velocity.
    """
    path = Path(path)
    lines = read_lines(path)
    end = next((k for k, line in enumerate(lines) if line.strip().startswith(_END)), len(lines))
    lines = lines[:end]
    layout = read_layout(lines, path)
    numeric = sorted(
        k + part
        for name, k in layout.token.items()
        if name in (*_REQUIRED, *_GEODETIC, *layout.position, *layout.velocity)
        and k < len(layout.names)
        for part in range(3 if name.startswith(("Lat", "Lon")) and not layout.degrees_only else 1)
    )
    table = read_table(path, layout.names, numeric=numeric, exact=False, lines=lines)
    place = {k: j for j, k in enumerate(numeric)}

    def column(name: str, part: int = 0) -> FloatArray:
        return table.values[:, place[layout.token[name] + part]]

    week_and_sow = np.column_stack([_whole_weeks(table, column("Week")), column("GPSTime")])
    late = late_weeks(week_and_sow)
    week = week_and_sow[:, 0] + late
    time = from_week_sow(week, week_and_sow[:, 1])
    increasing(table, time, "GPSTime")
    rpy = np.radians(np.column_stack([column(name) for name in _ATTITUDE]))
    if layout.position == _POSITION:
        pos_e = np.column_stack([column(name) for name in _POSITION])
        _check_geodetic(path, layout, column, pos_e)
    else:
        pos_e = _geodetic(layout, column)
    vel_e, notes = _velocity(path, layout, column, time, pos_e, rpy)
    if layout.position != _POSITION:
        notes.insert(0, "position from latitude, longitude and height")
    if late.any():
        notes.append(f"week number of {np.count_nonzero(late)} rows mended at the week's end")
    how = "columns from the header" if layout.from_header else "no header: 2020 layout assumed"
    return ReferenceTable(
        time=time,
        pos_e=pos_e,
        vel_e=vel_e,
        rpy=rpy,
        week=int(week[0]),
        week_line=int(table.line[0]),
        notes=("; ".join([sampling_note(time, f"reference {path.name}"), how, *notes]),),
    )


def _geodetic(layout: Layout, column: _Column) -> FloatArray:
    """Return ECEF positions from latitude, longitude and height."""
    if layout.degrees_only:
        lat, lon = np.radians(column("Latitude")), np.radians(column("Longitude"))
    else:
        lat, lon = (
            dms_to_radians(*(column(name, part) for part in range(3))) for name in _GEODETIC[:2]
        )
    return lla_to_ecef(lat, lon, column("H-Ell"))


def _velocity(
    path: Path,
    layout: Layout,
    column: _Column,
    time: FloatArray,
    pos_e: FloatArray,
    rpy: FloatArray,
) -> tuple[FloatArray, list[str]]:
    """Return ECEF velocities from what the file has, NaN where that is nothing, and notes."""
    value = (
        np.column_stack([column(name) for name in layout.velocity])
        if layout.velocity
        else np.empty((0, 3))
    )
    C_en = C_en_of(pos_e)
    if layout.velocity == _VELOCITY:
        _check_velocity(path, layout, time, pos_e, value)
        return value, []
    if layout.velocity == _LOCAL:
        vel_e = np.einsum("nij,nj->ni", C_en, value[:, [1, 0, 2]] * [1.0, 1.0, -1.0])
        _check_velocity(path, layout, time, pos_e, vel_e)
        return vel_e, ["velocity from VEast, VNorth, VUp"]
    why = "no velocity columns"
    if layout.velocity == _BODY:
        C_eb = C_en @ matrix_from_rpy(rpy)
        vel_e = np.einsum("nij,nj->ni", C_eb, value[:, [1, 0, 2]] * [1.0, 1.0, -1.0])
        apart, limit = _disagreement(time, pos_e, vel_e)
        if apart <= limit:
            return vel_e, ["velocity from body velocities and attitude"]
        why = f"body velocities left out, {apart:.3g} m/s from differenced positions (median)"
    if time.size < 3 or np.median(np.diff(time)) > _DIFFERENCED:
        return np.full_like(pos_e, np.nan), [f"{why}: no velocity"]
    vel_e = np.gradient(pos_e, time, axis=0)
    gap = np.diff(time) > _DIFFERENCED
    vel_e[np.concatenate([gap, [False]]) | np.concatenate([[False], gap])] = np.nan
    return vel_e, [f"{why}: velocity from differenced positions"]


def _whole_weeks(table: Table, week: FloatArray) -> NDArray[np.float64]:
    bad = np.flatnonzero((week != np.round(week)) | (week < 0) | (week > 9999))
    if bad.size:
        k = int(bad[0])
        raise DataError(
            f"Week: expected a GPS week number, found {week[k]:g}",
            file=table.file,
            line=int(table.line[k]),
        )
    return week


def _check_geodetic(path: Path, layout: Layout, column: _Column, pos_e: FloatArray) -> None:
    if not all(layout.token.get(name, len(layout.names)) < len(layout.names) for name in _GEODETIC):
        return
    apart = float(np.median(np.linalg.norm(_geodetic(layout, column) - pos_e, axis=1)))
    if apart > _POSITION_TOLERANCE:
        raise DataError(
            f"latitude, longitude, height and ECEF position are {apart:.3g} m apart (median), "
            f"expected < {_POSITION_TOLERANCE:g} m",
            file=path,
            remedy="check the columns (D M S are three tokens each) and the height's datum",
        )


def _disagreement(time: FloatArray, pos_e: FloatArray, vel_e: FloatArray) -> tuple[float, float]:
    """Return how far the mean of two velocities is from the way between, and its limit [m/s]."""
    step = np.diff(time)
    close = step < 1.5 * np.median(step)
    if not close.any():
        return 0.0, _VELOCITY_TOLERANCE
    between = np.diff(pos_e, axis=0)[close] / step[close, None]
    error = between - 0.5 * (vel_e[1:] + vel_e[:-1])[close]
    # 0.1 mm of printed position over a short step is noise, not contradiction
    limit = _VELOCITY_TOLERANCE + 2e-4 / float(np.median(step))
    return float(np.median(np.linalg.norm(error, axis=1))), limit


def _check_velocity(
    path: Path, layout: Layout, time: FloatArray, pos_e: FloatArray, vel_e: FloatArray
) -> None:
    apart, limit = _disagreement(time, pos_e, vel_e)
    if apart > limit:
        k = layout.token[layout.velocity[0]] + 1
        raise DataError(
            f"velocity (tokens {k}–{k + 2}) and differenced position disagree by {apart:.3g} m/s "
            f"(median), expected < {_VELOCITY_TOLERANCE:g} m/s",
            file=path,
            remedy="check the columns: with Easting they move by three",
        )


def read_reference(
    path: str | Path,
    *,
    point: str,
    lever_b: ArrayLike,
    attitude_frame: str = "b",
    source: str = "Inertial Explorer",
) -> tuple[Reference, tuple[str, ...]]:
    """Return an Inertial Explorer export as the reference trajectory of a declared point.

    Parameters
    ----------
    path : path
    point : str
        What the trajectory is of: 'imu', 'antenna' …; the file does not say.
    lever_b : array_like, shape (3,)
        From the IMU to that point, body axes [m].
    attitude_frame : {'b', 'v'}
    source : str

    Returns
    -------
    reference : Reference
    notes : tuple of str
    """
    t = read_reference_table(path)
    reference = Reference(
        time=t.time,
        pos_e=t.pos_e,
        vel_e=t.vel_e,
        rpy=t.rpy,
        lever_b=np.asarray(lever_b, dtype=float),
        point=point,
        source=source,
        attitude_frame=attitude_frame,
    )
    return reference, t.notes
