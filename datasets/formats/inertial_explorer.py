"""Reference trajectories exported by Inertial Explorer as text.

What a file holds is in its header, two lines of names and units, with or without ``%``/``#``
before them: week (also printed as 2179.00000), GPS seconds of week, ECEF position [m],
latitude and longitude in degrees, minutes and seconds — *three* tokens each, where the unit says
``(+/-D M S)`` — ellipsoidal height, ECEF velocity [m/s], and attitude [deg]: heading clockwise
from north, pitch nose up, roll right side down, which is roll-pitch-heading of a
forward-right-down body. With an ``Easting`` column everything after the height moves by three.
Without a header the layout of the 2020 GREAT files is assumed and then has to survive the
cross-checks: geodetic against ECEF position, and velocity against differenced position.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...filters.earth import lla_to_ecef
from ...filters.errors import DataError
from ...filters.rotation import FloatArray
from ..gpstime import from_week_sow
from ..series import Reference
from ..text.tables import Table, increasing, read_lines, read_table, sampling_note

_END = "Errors/warnings:"
_POSITION = ("X-ECEF", "Y-ECEF", "Z-ECEF")
_VELOCITY = ("VX-ECEF", "VY-ECEF", "VZ-ECEF")
_ATTITUDE = ("Roll", "Pitch", "Heading")
_REQUIRED = ("Week", "GPSTime", *_POSITION, *_VELOCITY, *_ATTITUDE)
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
    """

    token: dict[str, int]
    names: tuple[str, ...]
    degrees_only: bool
    from_header: bool


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
        names = _expand(list(_LAYOUT_2020), _LAYOUT_2020)
        return Layout(dict(_LAYOUT_2020), names, degrees_only=False, from_header=False)
    titles = lines[head].lstrip("%# \t").split()
    units = lines[head + 1] if head + 1 < len(lines) else ""
    degrees_only = "d m s" not in units.lower()
    canonical = {name.lower(): name for name in (*_REQUIRED, "Latitude", "Longitude", "H-Ell")}
    token: dict[str, int] = {}
    at = 0
    for title in titles:
        name = canonical.get(title.lower(), title)
        token.setdefault(name, at)
        at += 3 if name in ("Latitude", "Longitude") and not degrees_only else 1
    missing = [name for name in _REQUIRED if name not in token]
    if missing:
        raise DataError(
            f"header lacks {', '.join(missing)} (found {' '.join(titles[:8])} …)",
            file=path,
            line=head + 1,
            remedy="export the reference with these columns",
        )
    return Layout(token, _expand(titles, token), degrees_only, from_header=True)


def _expand(titles: list[str], token: dict[str, int]) -> tuple[str, ...]:
    """Return one name per token, up to the last required one."""
    width = 1 + max(token[name] for name in _REQUIRED)
    names = [f"column {k + 1}" for k in range(width)]
    for name, k in token.items():
        if k < width:
            names[k] = name
    for name in ("Latitude", "Longitude"):
        k = token.get(name, width)
        for part, label in enumerate(("D", "M", "S")):
            if k + part < width and (part == 0 or names[k + part].startswith("column")):
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
        if name in (*_REQUIRED, "Latitude", "Longitude", "H-Ell") and k < len(layout.names)
        for part in range(3 if name.startswith(("Lat", "Lon")) and not layout.degrees_only else 1)
    )
    table = read_table(path, layout.names, numeric=numeric, exact=False, lines=lines)
    place = {k: j for j, k in enumerate(numeric)}

    def column(name: str, part: int = 0) -> FloatArray:
        return table.values[:, place[layout.token[name] + part]]

    week = column("Week")
    time = from_week_sow(_whole_weeks(table, week), column("GPSTime"))
    increasing(table, time, "GPSTime")
    pos_e = np.column_stack([column(name) for name in _POSITION])
    vel_e = np.column_stack([column(name) for name in _VELOCITY])
    _check_geodetic(path, layout, column, pos_e)
    _check_velocity(path, layout, time, pos_e, vel_e)
    how = "columns from the header" if layout.from_header else "no header: 2020 layout assumed"
    return ReferenceTable(
        time=time,
        pos_e=pos_e,
        vel_e=vel_e,
        rpy=np.radians(np.column_stack([column(name) for name in _ATTITUDE])),
        week=int(week[0]),
        week_line=int(table.line[0]),
        notes=(sampling_note(time, f"reference {path.name}") + f"; {how}",),
    )


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


def _check_geodetic(path: Path, layout: Layout, column, pos_e: FloatArray) -> None:
    names = ("Latitude", "Longitude", "H-Ell")
    if not all(layout.token.get(name, len(layout.names)) < len(layout.names) for name in names):
        return
    if layout.degrees_only:
        lat, lon = np.radians(column("Latitude")), np.radians(column("Longitude"))
    else:
        lat, lon = (
            dms_to_radians(*(column(name, part) for part in range(3))) for name in names[:2]
        )
    apart = float(np.median(np.linalg.norm(lla_to_ecef(lat, lon, column("H-Ell")) - pos_e, axis=1)))
    if apart > _POSITION_TOLERANCE:
        raise DataError(
            f"latitude, longitude, height and ECEF position are {apart:.3g} m apart (median), "
            f"expected < {_POSITION_TOLERANCE:g} m",
            file=path,
            remedy="check the columns (D M S are three tokens each) and the height's datum",
        )


def _check_velocity(
    path: Path, layout: Layout, time: FloatArray, pos_e: FloatArray, vel_e: FloatArray
) -> None:
    """Compare the mean of two velocities with the position difference between them."""
    step = np.diff(time)
    close = step < 1.5 * np.median(step)
    if not close.any():
        return
    between = np.diff(pos_e, axis=0)[close] / step[close, None]
    error = between - 0.5 * (vel_e[1:] + vel_e[:-1])[close]
    apart = np.median(np.linalg.norm(error, axis=1))
    # 0.1 mm of printed position over a short step is noise, not contradiction
    if apart > _VELOCITY_TOLERANCE + 2e-4 / np.median(step):
        k = layout.token["VX-ECEF"] + 1
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
