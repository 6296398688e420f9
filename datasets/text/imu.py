"""Inertial data as plain text: ``sow gx gy gz ax ay az``, the form GREAT sets use.

The files hold rates, gyro first. Axes and units are not in them, and neither is the GPS week:
all three are declared, or told from physics by `datasets.physics`. A row is read as the mean
over the interval that ends at its stamp: a filtered sensor (ADIS16470 at 100 Hz, XW-GI7660 at
200 Hz) reports no instantaneous value, and its output is the newest average.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray
from ...filters.sensors import STANDARD_GRAVITY
from ..gpstime import SECONDS_PER_WEEK, from_week_sow
from ..series import ImuData
from .tables import Table, increasing, read_table, sampling_note

COLUMNS = ("sow", "gx", "gy", "gz", "ax", "ay", "az")

#: C_bs of the axes a file may be in: ``x_b = C_bs @ x_file``, b = forward-right-down.
AXES: dict[str, FloatArray] = {
    "RFU": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]),
    "FLU": np.diag([1.0, -1, -1]),
    "FRD": np.eye(3),
}
GYRO_UNITS = {"deg/s": np.pi / 180.0, "rad/s": 1.0}
ACCEL_UNITS = {"m/s2": 1.0, "g": STANDARD_GRAVITY}


@dataclass(frozen=True, eq=False)
class ImuTable:
    """The numbers of an IMU text file, not yet converted.

    Attributes
    ----------
    file : Path
    sow : ndarray, shape (n,)
        Seconds of the first row's week; they run on past 604800 where the file does.
    gyro, accel : ndarray, shape (n, 3)
        As in the file.
    notes : tuple of str
    """

    file: Path
    sow: FloatArray
    gyro: FloatArray
    accel: FloatArray
    notes: tuple[str, ...]


def read_imu_table(path: str | Path) -> ImuTable:
    """Return the seven columns of an IMU text file.

    Every line whose first token is not a number is skipped (files come with none or one header
    line). Dropped epochs are tolerated and reported; time that goes backwards is not.

    Raises
    ------
    DataError
        Wrong column count, a token that is no finite number, time not increasing, with the line.
    """
    table = read_table(path, COLUMNS)
    sow = _unroll_week(table, table.values[:, 0])
    if sow.size < 2:
        raise DataError(f"expected at least 2 rows, found {sow.size}", file=path)
    increasing(table, sow, "sow")
    notes = [sampling_note(sow, f"IMU {table.file.name}")]
    if table.skipped:
        lines = ", ".join(map(str, table.skipped[:5]))
        notes.append(f"IMU {table.file.name}: skipped lines without data: {lines}")
    return ImuTable(table.file, sow, table.values[:, 1:4], table.values[:, 4:7], tuple(notes))


def _unroll_week(table: Table, sow: FloatArray) -> FloatArray:
    latest = SECONDS_PER_WEEK + 86400.0  # some files count on past the end of the week
    if sow.min() < 0.0 or sow.max() > latest:
        k = int(np.argmax((sow < 0.0) | (sow > latest)))
        raise DataError(
            f"sow: expected seconds of week (0…604800), found {sow[k]:.3f}",
            file=table.file,
            line=int(table.line[k]),
            remedy="convert the time column to GPS seconds of week",
        )
    rollover = np.diff(sow, prepend=sow[0]) < -SECONDS_PER_WEEK / 2
    return sow + SECONDS_PER_WEEK * np.cumsum(rollover)


def convert(table: ImuTable, *, week: int, gyro_unit: str, accel_unit: str, axes: str) -> ImuData:
    """Return the table in SI, forward-right-down and GPS time.

    Parameters
    ----------
    table : ImuTable
    week : int
        GPS week of the first row; the file does not hold it.
    gyro_unit : {'deg/s', 'rad/s'}
    accel_unit : {'m/s2', 'g'}
    axes : {'RFU', 'FLU', 'FRD'}
        x, y, z of the file: right-forward-up, forward-left-up, forward-right-down.
    """
    for key, value, known in (
        ("gyro_unit", gyro_unit, GYRO_UNITS),
        ("accel_unit", accel_unit, ACCEL_UNITS),
        ("axes", axes, AXES),
    ):
        if value not in known:
            raise ConfigError(f"{key}: expected one of {', '.join(known)}, found {value!r}")
    C_bs = AXES[axes]
    return ImuData(
        time=from_week_sow(week, table.sow),
        gyro_b=GYRO_UNITS[gyro_unit] * table.gyro @ C_bs.T,
        accel_b=ACCEL_UNITS[accel_unit] * table.accel @ C_bs.T,
    )


def read_imu_text(
    path: str | Path, *, week: int, gyro_unit: str, accel_unit: str = "m/s2", axes: str = "RFU"
) -> ImuData:
    """Return an IMU text file converted as declared: `read_imu_table`, then `convert`."""
    return convert(
        read_imu_table(path), week=week, gyro_unit=gyro_unit, accel_unit=accel_unit, axes=axes
    )


def rates_from_increments(time: FloatArray, increment: FloatArray) -> FloatArray:
    """Return mean rates of increments over the interval that ends at each stamp.

    Parameters
    ----------
    time : ndarray, shape (n,)
        [s].
    increment : ndarray, shape (n, 3)

    Returns
    -------
    ndarray, shape (n, 3)
        Increments over the stamps' differences. The first interval, and one in which rows are
        missing (1.5 times the usual length and more), count as of the usual length: increments
        of lost rows are lost, not in the next one.
    """
    step = np.diff(time, prepend=time[0])
    usual = float(np.median(step[1:]))
    step[0] = usual
    step[step > 1.5 * usual] = usual
    return increment / step[:, None]
