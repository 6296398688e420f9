"""GREAT-PVT solutions (``.flt``): the usual input of GREAT-MSF's loose coupling.

Twenty white-space columns under ``#`` headers: GPS seconds of week, ECEF position and velocity,
their standard deviations, satellites, PDOP, sigma0, ambiguity status (Fixed, Float …), ratio,
baseline, quality. No week. RTK solutions leave the velocity columns 0, which is no velocity.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...filters.errors import DataError
from ..displacement import check_velocity
from ..gpstime import SECONDS_PER_WEEK, from_week_sow
from ..observations import GnssFixes
from ..text.tables import increasing, read_lines, read_table

COLUMNS = (
    *("SOW", "X", "Y", "Z", "Vx", "Vy", "Vz"),
    *("X-RMS", "Y-RMS", "Z-RMS", "Vx-RMS", "Vy-RMS", "Vz-RMS"),
    *("NSat", "PDOP", "sigma0", "AmbStatus", "Ratio", "BL", "Quality"),
)
_STATUS = COLUMNS.index("AmbStatus")


def is_flt(path: Path) -> bool:
    """Return whether the first lines name GREAT-PVT's columns."""
    with path.open(encoding="utf-8", errors="replace") as stream:
        head = [stream.readline() for _ in range(20)]
    return any(line.lstrip()[:1] == "#" and "AmbStatus" in line for line in head)


def read_flt(path: str | Path, *, week: int) -> tuple[GnssFixes, tuple[str, ...]]:
    """Return the fixes of a GREAT-PVT solution.

    Parameters
    ----------
    path : path
    week : int
        GPS week of the first row; the file does not hold it.

    Returns
    -------
    fixes : GnssFixes
        'fixed', 'float', or the status as printed, in lower case.
    notes : tuple of str

    Raises
    ------
    DataError
        Another number of columns, times that do not increase, positions off the Earth's surface,
        or a velocity that contradicts them.
    """
    path = Path(path)
    _check_header(path)
    table = read_table(path, COLUMNS, numeric=range(_STATUS - 2), text=(_STATUS,))
    sow, value = table.values[:, 0], table.values
    rollover = np.diff(sow, prepend=sow[0]) < -SECONDS_PER_WEEK / 2
    time = from_week_sow(week + np.cumsum(rollover), sow)
    increasing(table, time, "SOW")
    radius = np.linalg.norm(value[:, 1:4], axis=1)
    bad = (radius < 6.3e6) | (radius > 6.5e6) | ~(value[:, 7:10] > 0.0).all(axis=1)
    if bad.any():
        k = int(np.argmax(bad))
        raise DataError(
            f"expected an ECEF position with RMS > 0, found {value[k, 1:4]} ± {value[k, 7:10]} m",
            file=path,
            line=int(table.line[k]),
            remedy="an epoch without solution? remove it",
        )
    moving = (value[:, 4:7] != 0.0).any(axis=1)
    usable = moving & (value[:, 10:13] > 0.0).all(axis=1)
    n, eye = time.size, np.eye(3)
    vel_e = np.where(usable[:, None], value[:, 4:7], np.nan)
    sigma = np.hypot(*value[:, 7:9].T)
    check_velocity(time, value[:, 1:4], vel_e, sigma, file=path, declared="ECEF")
    fixes = GnssFixes(
        time=time,
        pos_e=value[:, 1:4],
        pos_cov_e=value[:, 7:10, None] ** 2 * eye,
        vel_e=vel_e,
        vel_cov_e=np.where(usable[:, None, None], value[:, 10:13, None] ** 2 * eye, np.nan),
        satellites=value[:, 13].astype(int),
        quality=np.char.lower(table.text[0]),
    )
    counts = ", ".join(f"{(fixes.quality == q).sum()} {q}" for q in np.unique(fixes.quality))
    notes = [f"GREAT-PVT {path.name}: {n} epochs ({counts})"]
    if not usable.all():
        notes.append(f"{n - int(usable.sum())} of them with velocity 0 or without RMS: none taken")
    return fixes, tuple(notes)


def _check_header(path: Path) -> None:
    """Refuse a file whose header puts the ambiguity status elsewhere."""
    for number, line in enumerate(read_lines(path)[:50], start=1):
        tokens = line.lstrip().lstrip("#").split()
        if line.lstrip()[:1] == "#" and "AmbStatus" in tokens:
            expected, behind = COLUMNS[_STATUS + 1 :], tokens[tokens.index("AmbStatus") + 1 :]
            if len(behind) != len(expected):
                raise DataError(
                    f"expected {' '.join(expected)} after AmbStatus, found "
                    f"{' '.join(behind) or 'nothing'}",
                    file=path,
                    line=number,
                    remedy="write the solution with GREAT-PVT's own columns",
                )
            return
