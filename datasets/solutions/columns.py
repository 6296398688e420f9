"""CSV with named columns: certnav's ``solution.csv``, or anybody's with the same names.

=============================================  ==============================================
time_gps_s, or week and sow_s                  time; one of the two is needed
lat_deg, lon_deg, height_m, or pos_e_x_m …     position; one of the two is needed
vel_n_mps, vel_e_mps, vel_d_mps                velocity north, east, down
roll_deg, pitch_deg, heading_deg               attitude of forward-right-down axes
std_pos_n_m …, std_vel_n_mps …, std_roll_deg   1σ of each, likewise
=============================================  ==============================================

Other columns are not read; an empty cell or ``nan`` is nothing stated.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...filters.earth import C_en_of, lla_to_ecef
from ...filters.errors import DataError
from ...filters.rotation import FloatArray
from ..gpstime import from_week_sow
from ..text.tables import LARGEST, check_head, read_lines
from .solution import ForeignSolution, checked_places, diagonal

_TIME, _WEEK = ("time_gps_s",), ("week", "sow_s")
_GEODETIC, _ECEF = ("lat_deg", "lon_deg", "height_m"), ("pos_e_x_m", "pos_e_y_m", "pos_e_z_m")
_RPY = ("roll_deg", "pitch_deg", "heading_deg")


def is_columns(path: Path) -> bool:
    """Return whether the first line names a time and a position."""
    with path.open(encoding="utf-8-sig", errors="replace") as stream:
        names = {name.strip() for name in stream.readline().split(",")}
    timed = any(set(n) <= names for n in (_TIME, _WEEK))
    return timed and any(set(n) <= names for n in (_GEODETIC, _ECEF))


def read_columns(path: Path) -> ForeignSolution:
    """Return a CSV with named columns.

    Raises
    ------
    DataError
        A column missing or named twice, a row of another width, a cell that is no number, times
        that do not increase, positions off the Earth's surface.
    """
    check_head(path)
    lines = read_lines(path)
    names = [name.strip() for name in lines[0].lstrip("\ufeff").split(",")]
    if len(set(names)) != len(names):
        twice = next(n for n in names if names.count(n) > 1)
        raise DataError(f"column '{twice}' is there twice", file=path, line=1)
    value, line = _numbers(path, lines, len(names))
    column = {name: value[:, k] for k, name in enumerate(names)}
    time = _needed(path, column, line, _TIME, _WEEK)
    time = time[:, 0] if time.shape[1] == 1 else from_week_sow(time[:, 0], time[:, 1])
    if not (np.diff(time) > 0.0).all():
        k = int(np.argmin(np.diff(time) > 0.0)) + 1
        raise DataError(
            f"time: expected to increase, found {time[k]:.3f} after {time[k - 1]:.3f} s",
            file=path,
            line=int(line[k]),
        )
    pos_e = _needed(path, column, line, _ECEF, _GEODETIC)
    if not set(_ECEF) <= set(column):
        if (np.abs(pos_e[:, 0]) > 90.0).any() or (np.abs(pos_e[:, 1]) > 360.0).any():
            k = int(np.argmax((np.abs(pos_e[:, 0]) > 90.0) | (np.abs(pos_e[:, 1]) > 360.0)))
            raise DataError(
                f"expected latitude and longitude in degrees, found {pos_e[k, :2].tolist()}",
                file=path,
                line=int(line[k]),
            )
        lat, lon = np.radians(pos_e[:, :2]).T
        pos_e = lla_to_ecef(lat, lon, pos_e[:, 2])
    checked_places(pos_e, line, path)
    vel_n = _stated(column, [f"vel_{a}_mps" for a in "ned"], len(time))
    sigma = [[f"std_pos_{a}_m" for a in "ned"], [f"std_vel_{a}_mps" for a in "ned"]]
    pos, vel = (_stated(column, s, len(time)) for s in sigma)
    angles = _stated(column, [f"std_{a}" for a in _RPY], len(time))
    return ForeignSolution(
        source=f"CSV {path.name}", time=time, pos_e=pos_e,
        vel_e=(C_en_of(pos_e) @ vel_n[:, :, None])[:, :, 0],
        rpy=np.radians(_stated(column, _RPY, len(time))),
        cov_pos_n=diagonal(pos), cov_vel_n=diagonal(vel),
        sigma_rpy=np.radians(np.where(angles > 0.0, angles, np.nan)),
    )  # fmt: skip


def _numbers(path: Path, lines: list[str], width: int) -> tuple[FloatArray, NDArray[np.int64]]:
    rows, numbers = [], []
    for number, text in enumerate(lines[1:], start=2):
        if not text.strip():
            continue
        cells = text.split(",")
        if len(cells) != width:
            raise DataError(f"expected {width} columns, found {len(cells)}", file=path, line=number)
        try:
            rows.append([float(cell) if cell.strip() else np.nan for cell in cells])
        except ValueError:
            word = next(c for c in cells if not _is_number(c))
            raise DataError(
                f"expected a number, found '{word.strip()[:40]}'", file=path, line=number
            ) from None
        numbers.append(number)
    if len(rows) < 2:
        raise DataError(f"expected at least 2 rows, found {len(rows)}", file=path)
    return np.array(rows), np.array(numbers)


def _is_number(cell: str) -> bool:
    try:
        float(cell or "nan")
    except ValueError:
        return not cell.strip()
    return True


def _needed(
    path: Path, column: dict[str, FloatArray], line: NDArray[np.int64], *choices: tuple[str, ...]
) -> FloatArray:
    """Return the first of the choices that the file has, all of it finite."""
    for names in choices:
        if set(names) <= set(column):
            value = np.column_stack([column[name] for name in names])
            bad = ~(np.abs(value) <= LARGEST)
            if bad.any():
                row, k = (int(i) for i in np.argwhere(bad)[0])
                raise DataError(
                    f"{names[k]}: expected a finite number, found {value[row, k]}",
                    file=path,
                    line=int(line[row]),
                )
            return value
    raise DataError(
        f"expected the columns {' or '.join(', '.join(names) for names in choices)}",
        file=path,
        line=1,
    )


def _stated(
    column: dict[str, FloatArray], names: list[str] | tuple[str, ...], n: int
) -> FloatArray:
    """Return columns that may be missing; NaN what is not stated."""
    if not set(names) <= set(column):
        return np.full((n, 3), np.nan)
    value = np.column_stack([column[name] for name in names])
    return np.where(np.abs(value) <= LARGEST, value, np.nan)
