"""RTKLIB's and GINav's solution files (``.pos``), and the truth that GINav ships (``.mat``).

GINav (Chen and Chang 2021) writes RTKLIB's columns; its coupled solutions add pitch, roll and yaw
in degrees, yaw clockwise from north, and six columns of their σ. There ``sdy`` is the σ of yaw,
which has the name of a position's second σ: those columns are told by their place, the last nine.
A σ of 0 is none. A plain ``.pos`` follows the antenna, one with attitude the IMU, as GINav's do.

The truth of its car drive is a MATLAB 5 struct array ``reference``: week, sow, pos (ECEF), vel
(ECEF), att (pitch, roll, yaw [deg], yaw clockwise from north).
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...filters.errors import DataError
from ...filters.rotation import FloatArray
from ..formats.rtklib_pos import is_pos, read_pos
from ..gpstime import from_week_sow
from ..text.tables import LARGEST, cannot_open, read_lines
from .solution import ForeignSolution, checked_places, turned_to_ned

_ATTITUDE = ("pitch(deg)", "roll(deg)", "yaw(deg)", "sdp", "sdr", "sdy", "sdpr", "sdry", "sdyp")
_MAT = ("week", "sow", "pos", "vel", "att")


def read_rtklib(path: Path) -> ForeignSolution:
    """Return a ``.pos``, of RTKLIB or of GINav.

    Raises
    ------
    DataError
        As `datasets.formats.rtklib_pos.read_pos`, or attitude columns that are not numbers.
    """
    lines = read_lines(path)
    wide = any(_names(line)[-len(_ATTITUDE) :] == list(_ATTITUDE) for line in lines[:200])
    cut = None
    if wide:
        lines, cut = _without_attitude(lines, path)
    fixes = read_pos(path, lines=lines)
    pos_cov = turned_to_ned(fixes.pos_e, _stated(fixes.pos_cov_e))
    rpy = sigma = np.zeros(0)  # not stated
    if cut is not None:
        pitch, roll, yaw, sd_pitch, sd_roll, sd_yaw = np.radians(cut[:, :6]).T
        rpy = np.column_stack([roll, pitch, yaw])
        sigma = np.column_stack([sd_roll, sd_pitch, sd_yaw])
        sigma = np.where(sigma > 0.0, sigma, np.nan)
    notes = ("attitude of the IMU, yaw clockwise from north",) if wide else ()
    return ForeignSolution(
        source=f"{'GINav' if wide else 'RTKLIB'} {path.name}",
        time=fixes.time,
        pos_e=fixes.pos_e,
        vel_e=fixes.vel_e,
        rpy=rpy,
        cov_pos_n=pos_cov,
        cov_vel_n=turned_to_ned(fixes.pos_e, _stated(fixes.vel_cov_e)),
        sigma_rpy=sigma,
        point="imu" if wide else "antenna",
        notes=notes,
    )


def is_rtklib(path: Path) -> bool:
    """Return whether a file names RTKLIB's columns."""
    return is_pos(path)


def _names(line: str) -> list[str]:
    return re.split(r"\s+", line.strip()) if line.startswith("%") else []


def _without_attitude(lines: list[str], path: Path) -> tuple[list[str], FloatArray]:
    """Return the lines with RTKLIB's columns alone, and the nine columns of attitude."""
    width, plain, rows = len(_ATTITUDE), [], []
    for number, line in enumerate(lines, start=1):
        if line.startswith("%"):
            names = _names(line)
            cut = names[-width:] == list(_ATTITUDE)
            plain.append(" ".join(names[:-width]) if cut else line)
            continue
        tokens = line.split()
        if not tokens or not tokens[0][:1].isdigit():
            plain.append(line)
            continue
        plain.append(" ".join(tokens[:-width]))
        try:
            rows.append([float(token) for token in tokens[-width:]])
        except ValueError:
            raise DataError(
                f"attitude: expected {width} numbers, found '{' '.join(tokens[-width:])}'",
                file=path,
                line=number,
            ) from None
        if len(rows[-1]) != width or not np.abs(rows[-1]).max() <= LARGEST:
            raise DataError(
                f"attitude: expected {width} finite numbers, found '{' '.join(tokens[-width:])}'",
                file=path,
                line=number,
            )
    return plain, np.array(rows).reshape(-1, width)


def _stated(cov_e: FloatArray) -> FloatArray:
    """Return covariances, NaN where a variance is 0: RTKLIB's way of saying none."""
    variance = np.diagonal(cov_e, axis1=1, axis2=2)
    positive = np.all(variance > 0.0, axis=1)
    return np.where(positive[:, None, None], cov_e, np.nan)


def read_ginav_truth(path: Path) -> ForeignSolution:
    """Return the truth of GINav's car drive.

    Raises
    ------
    DataError
        Not MATLAB 5, no such struct, or a row that is not numbers.
    """
    from scipy.io import loadmat

    try:
        held = loadmat(str(path), variable_names=["reference"])
    except OSError as error:
        raise cannot_open(path, error) from None
    except Exception as error:  # whatever damaged bytes lead the decoder into
        raise DataError(f"not readable as MATLAB 5: {error}".splitlines()[0], file=path) from None
    table = held.get("reference")
    if table is None or not set(_MAT) <= set(getattr(table.dtype, "names", None) or ()):
        raise DataError(f"expected a struct 'reference' with {', '.join(_MAT)}", file=path)
    columns = [_column(path, table, name, 1 if name in ("week", "sow") else 3) for name in _MAT]
    week, sow, pos_e, vel_e, att = columns
    time = from_week_sow(week[:, 0], sow[:, 0])
    if not (np.diff(time) > 0.0).all():
        k = int(np.argmin(np.diff(time) > 0.0)) + 2
        raise DataError("time: expected to increase", file=path, line=k)
    checked_places(pos_e, np.arange(1, len(pos_e) + 1), path)
    pitch, roll, yaw = np.radians(att).T
    return ForeignSolution(
        source=f"GINav truth {path.name}", time=time, pos_e=pos_e, vel_e=vel_e,
        rpy=np.column_stack([roll, pitch, yaw]),
    )  # fmt: skip


def _column(path: Path, table: NDArray[np.void], name: str, width: int) -> FloatArray:
    cells = table[name].ravel()
    out = np.full((cells.size, width), np.nan)
    for k, cell in enumerate(cells):
        try:
            out[k] = np.asarray(cell, dtype=float).reshape(width)
        except (TypeError, ValueError):
            raise DataError(
                f"reference.{name}: expected {width} numbers", file=path, line=k + 1
            ) from None
    bad = ~(np.abs(out) <= LARGEST).all(axis=1)
    if bad.any():
        line = int(np.argmax(bad)) + 1
        raise DataError(f"reference.{name}: expected finite numbers", file=path, line=line)
    return out
