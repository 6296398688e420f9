"""Trajectories of KF-GINS (``.nav``), GREAT (``.ins``, ``.flt``) and in TUM's format.

**KF-GINS** ``.nav``: `datasets.formats.kfgins.read_nav`; of the IMU, no σ.

**GREAT-PVT** ``.flt``: `datasets.great.pvt.read_flt`; of the antenna, with σ, no attitude.

**GREAT-MSF** ``.ins``, under ``#`` headers: seconds of week, ECEF position and velocity, pitch,
roll and yaw [deg], biases, and more; of the IMU, no σ. Its yaw counts from north to *west*, and
pitch and roll are those of right-forward-up axes about their own x and y, which for
forward-right-down axes are pitch and roll of the same sign (GREAT-MSF manual 1.1).

**TUM**: ``timestamp tx ty tz qx qy qz qw``. Its axes are nobody's in particular. They are ECEF
where the positions are as far from the origin as the Earth's surface; else a comment has to name
the origin of east-north-up axes, as certnav writes it: ``ENU origin lat … deg, lon … deg, height
… m``. Times are GPS seconds, or Unix seconds where a comment says ``Unix``; the quaternion turns
forward-right-down axes into those of the positions.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ...filters.earth import C_en_at, C_en_of, lla_to_ecef
from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray, rpy_from_matrix
from ..formats.kfgins import kind_of, read_nav
from ..gpstime import SECONDS_PER_WEEK, from_unix, from_week_sow
from ..great.pvt import is_flt, read_flt
from ..text.tables import Table, increasing, read_lines, read_table
from .solution import ForeignSolution, checked_places, turned_to_ned

_INS = ("sow", "X", "Y", "Z", "VX", "VY", "VZ", "pitch", "roll", "yaw")
_TUM = ("time", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
_NUMBER = r"([-+]?\d+(?:\.\d*)?)"
_ORIGIN = re.compile(
    rf"ENU origin lat {_NUMBER} deg, lon {_NUMBER} deg, height {_NUMBER} m", re.IGNORECASE
)
_FROM_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
#: Positions at least so far from the origin are of the whole Earth [m].
_EARTH = 6.0e6
#: A quaternion is one to so much, as files are rounded.
_UNIT = 1e-2


def is_kfgins_nav(path: Path) -> bool:
    """Return whether the rows are those of a KF-GINS result."""
    return kind_of(path) == "nav"


def read_kfgins_nav(path: Path, week: int | None = None) -> ForeignSolution:
    """Return a KF-GINS result; `week` where its own column has none."""
    nav = read_nav(path, week=week or 0)
    if not nav.week:
        raise _week_wanted(path)
    return ForeignSolution(
        source=f"KF-GINS {path.name}", time=nav.time, pos_e=nav.pos_e, vel_e=nav.vel_e, rpy=nav.rpy
    )


def is_great_flt(path: Path) -> bool:
    """Return whether the header is GREAT-PVT's."""
    return is_flt(path)


def read_great_flt(path: Path, week: int | None = None) -> ForeignSolution:
    """Return a GREAT-PVT result; it holds no week."""
    if not week:
        raise _week_wanted(path)
    fixes, notes = read_flt(path, week=week)
    return ForeignSolution(
        source=f"GREAT-PVT {path.name}", time=fixes.time, pos_e=fixes.pos_e, vel_e=fixes.vel_e,
        cov_pos_n=turned_to_ned(fixes.pos_e, fixes.pos_cov_e),
        cov_vel_n=turned_to_ned(fixes.pos_e, fixes.vel_cov_e), point="antenna", notes=notes,
    )  # fmt: skip


def is_great_ins(path: Path) -> bool:
    """Return whether the header is GREAT-MSF's."""
    with path.open(encoding="utf-8", errors="replace") as stream:
        head = [stream.readline() for _ in range(20)]
    return any(line.lstrip()[:1] == "#" and "MeasType" in line for line in head)


def read_great_ins(path: Path, week: int | None = None) -> ForeignSolution:
    """Return a GREAT-MSF result; it holds no week.

    Raises
    ------
    DataError
        Times that are no seconds of week or do not increase, positions off the Earth's surface.
    """
    if not week:
        raise _week_wanted(path)
    table = read_table(path, _INS, numeric=range(len(_INS)), exact=False)
    sow, value = table.values[:, 0], table.values
    bad = ~((sow >= 0.0) & (sow <= SECONDS_PER_WEEK + 86400.0))
    if bad.any():
        k = int(np.argmax(bad))
        raise DataError(
            f"sow: expected seconds of week, found {sow[k]:g}", file=path, line=int(table.line[k])
        )
    rollover = np.diff(sow, prepend=sow[0]) < -SECONDS_PER_WEEK / 2
    time = from_week_sow(week + np.cumsum(rollover), sow)
    increasing(table, time, "sow")
    checked_places(value[:, 1:4], table.line, path)
    pitch, roll, yaw = np.radians(value[:, 7:10]).T
    return ForeignSolution(
        source=f"GREAT-MSF {path.name}", time=time, pos_e=value[:, 1:4], vel_e=value[:, 4:7],
        rpy=np.column_stack([roll, pitch, -yaw]), notes=("yaw counted from north to west",),
    )  # fmt: skip


def is_tum(path: Path) -> bool:
    """Return whether the first rows are eight numbers with a quaternion at their end."""
    with path.open(encoding="utf-8", errors="replace") as stream:
        rows = [line.split() for line in (stream.readline() for _ in range(20))]
    rows = [row for row in rows if row and not row[0].startswith("#")]
    try:
        value = np.array(rows[:5], dtype=float)
    except ValueError:
        return False
    if value.ndim != 2 or value.shape[1] != len(_TUM):
        return False
    return bool((np.abs(np.linalg.norm(value[:, 4:], axis=1) - 1.0) < _UNIT).all())


def read_tum(path: Path) -> ForeignSolution:
    """Return a TUM trajectory.

    Raises
    ------
    DataError
        Axes that are not known, quaternions that are none, times that do not increase.
    """
    lines = read_lines(path)
    comments = [line for line in lines if line.lstrip().startswith("#")]
    table = read_table(path, _TUM, lines=lines)
    time, value = table.values[:, 0], table.values
    unix = any("unix" in line.lower() for line in comments)
    increasing(table, time, "time")
    time = from_unix(time) if unix else time
    C_ew = _quaternions(table, path)
    origin = next((m for line in comments if (m := _ORIGIN.search(line))), None)
    if np.median(np.linalg.norm(value[:, 1:4], axis=1)) > _EARTH:
        pos_e, axes = value[:, 1:4], "ECEF"
    elif origin is not None:
        lat, lon, height = (float(v) for v in origin.groups())
        if abs(lat) > 90.0 or abs(lon) > 360.0 or abs(height) > 1e5:
            raise DataError(f"origin: expected a place, found {origin[0]}", file=path)
        C_e_enu = C_en_at(np.radians(lat), np.radians(lon)) @ _FROM_ENU
        pos_e = lla_to_ecef(np.radians(lat), np.radians(lon), height) + value[:, 1:4] @ C_e_enu.T
        C_ew, axes = C_e_enu @ C_ew, "east-north-up"
    else:
        raise DataError(
            "axes of the positions unknown: neither ECEF nor with an origin",
            file=path,
            line=int(table.line[0]),
            remedy="add a line: # ENU origin lat 35.6 deg, lon 139.7 deg, height 40.0 m",
        )
    checked_places(pos_e, table.line, path)
    C_ne = np.swapaxes(C_en_of(pos_e), 1, 2)
    scale = "Unix" if unix else "GPS"
    return ForeignSolution(
        source=f"TUM {path.name}", time=time, pos_e=pos_e, rpy=rpy_from_matrix(C_ne @ C_ew),
        notes=(f"{axes} axes, {scale} seconds, body axes forward-right-down",),
    )  # fmt: skip


def _quaternions(table: Table, path: Path) -> FloatArray:
    q = table.values[:, 4:]
    size = np.linalg.norm(q, axis=1)
    bad = ~(np.abs(size - 1.0) < _UNIT)
    if bad.any():
        k = int(np.argmax(bad))
        raise DataError(
            f"quaternion: expected length 1, found {size[k]:.3g}",
            file=path,
            line=int(table.line[k]),
        )
    from scipy.spatial.transform import Rotation  # slow to import

    C: FloatArray = Rotation.from_quat(q).as_matrix()
    return C


def _week_wanted(path: Path) -> ConfigError:
    return ConfigError(
        f"{path}: holds seconds of week and no week: give --week 2179, or a recording to compare "
        "with"
    )
