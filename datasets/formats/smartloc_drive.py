"""The car of a smartLoc run, and its truth: odometer, yaw rate, SPAN, and the receiver's positions.

``MY_DATASET.csv`` (commas) has them for the whole run; `smartloc` says how they are to be read.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...filters.earth import lla_to_ecef
from ...filters.errors import DataError
from ...filters.rotation import FloatArray, wrap_angle
from ...filters.sensors import ImuSpec
from ..gpstime import from_week_sow
from ..observations import GnssFixes
from ..physics import gyro_unit_ratio, refuse
from ..sequence import Calibration
from ..series import Odometer, Reference
from ..text.columns import Columns, open_text, read_columns
from ..text.tables import increasing, sampling_note

_DRIVE = {
    "week": (1,),
    "sow": (2,),
    "place": (7, 6, 8),
    "heading": (9,),
    "speed_sow": (11,),
    "speed": (12,),
    "yaw_sow": (13,),
    "yaw_rate": (14,),
}
_RECEIVER = {"week": (1,), "sow": (2,), "place": (4, 3, 5), "heading": (9,)}
#: 1σ per axis of positions that come without [m]; those with it in the canyon say 0.5 to 30 m.
_FIX_SIGMA = 15.0
#: A set without inertial sensors: no information from them.
NO_IMU = ImuSpec("none", "the set has no IMU", *[np.inf] * 6)


def calibration(lever_sigma_m: float) -> Calibration:
    """Return what is known of the car: nothing about levers."""
    return Calibration(
        imu=NO_IMU,
        lever_antenna_b=np.zeros(3),
        lever_antenna_source="not documented: zero assumed",
        lever_antenna_sigma=lever_sigma_m,
    )


def reference_note(reference: Reference) -> str:
    """Say what the truth is and is not."""
    return (
        sampling_note(reference.time, "reference") + "; point and lever arm not documented, "
        "no roll and pitch; velocity from differenced positions"
    )


class Drive(NamedTuple):
    """What the car and the truth say of the whole run."""

    odometer: Odometer
    reference: Reference
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        return f"Drive({self.odometer!r}, {self.reference!r})"


def read_drive(file: Path) -> Drive:
    """Return odometer and truth.

    Raises
    ------
    DataError
        An unreadable file, or an odometer that contradicts the truth.
    """
    rows = read_numbered(file, _DRIVE, text={})
    truth, odometer = Truth.of(rows, "place", "heading"), _odometer(rows)
    notes = (
        sampling_note(odometer.time, "odometer"),
        _check_yaw_rate(odometer, truth, file),
    )
    return Drive(odometer, reference_of(truth), notes)


def receiver_fixes(file: Path) -> GnssFixes:
    """Return the receiver's positions of the whole run, which come without any accuracy."""
    seen = Truth.of(read_numbered(file, _RECEIVER, text={}), "place", "heading")
    n = seen.time.size
    return GnssFixes(
        time=seen.time,
        pos_e=seen.pos_e,
        pos_cov_e=np.tile(np.eye(3) * _FIX_SIGMA**2, (n, 1, 1)),
        vel_e=np.full((n, 3), np.nan),
        vel_cov_e=np.full((n, 3, 3), np.nan),
        satellites=np.full(n, -1),
        quality=np.full(n, "receiver"),
    )


def read_numbered(
    file: Path, numbers: dict[str, tuple[int, ...]], text: dict[str, tuple[int, ...]]
) -> Columns:
    """Return columns by number: their headers are sentences."""
    source = open_text(file)
    width = max(k for columns in numbers.values() for k in columns)
    if source.width < width:
        raise DataError(f"expected {width} columns or more, found {source.width}", file=file)
    return read_columns(source, numbers, text)


@dataclass(frozen=True, eq=False)
class Truth:
    """Where and which way, one row per epoch."""

    time: FloatArray
    pos_e: FloatArray
    heading: FloatArray

    @classmethod
    def of(cls, rows: Columns, place: str, heading: str) -> Truth:
        time = from_week_sow(rows.numbers["week"][:, 0], rows.numbers["sow"][:, 0])
        if (np.diff(time) < 0.0).any():
            increasing(rows.table, time, "GPSSecondsOfWeek")
        _, first = np.unique(time, return_index=True)
        if first.size < 2:
            raise DataError(
                f"expected at least 2 epochs of truth, found {first.size}", file=rows.table.file
            )
        lla = rows.numbers[place][first] * [np.pi / 180.0, np.pi / 180.0, 1.0]
        north = wrap_angle(np.pi / 2 - rows.numbers[heading][first, 0])
        return cls(time[first], lla_to_ecef(*lla.T), north)


def _odometer(drive: Columns) -> Odometer:
    """Return speed, and yaw rate interpolated to its stamps."""
    week = drive.numbers["week"][:, 0]
    at = from_week_sow(week, drive.numbers["speed_sow"][:, 0])
    turned = from_week_sow(week, drive.numbers["yaw_sow"][:, 0])
    increasing(drive.table, at, "GPSSecondsOfWeek - Velocity")
    increasing(drive.table, turned, "GPSSecondsOfWeek - Yawrate")
    return Odometer(
        time=at,
        speed=drive.numbers["speed"][:, 0],
        yaw_rate=-np.interp(at, turned, drive.numbers["yaw_rate"][:, 0]),
    )


def _check_yaw_rate(odometer: Odometer, truth: Truth, file: Path) -> str:
    assert odometer.yaw_rate is not None
    found = gyro_unit_ratio(odometer.time, odometer.yaw_rate, truth.time, truth.heading)
    if not found.conclusive:
        return "yaw rate: taken as documented, too little turning to verify"
    if not found.is_close_to(1.0):
        problem = (
            f"yaw rate contradicts the truth's heading: its integral is {found.ratio:.3g} ± "
            f"{found.sigma:.1g} times the change, expected 1 (rad/s, positive to the left)"
        )
        remedy = "check unit and sign of the yaw rate"
        return refuse(DataError(problem, file=file, remedy=remedy), "course")
    return f"yaw rate verified: integral / heading change = {found.ratio:.3f} ± {found.sigma:.3f}"


def reference_of(truth: Truth) -> Reference:
    rpy = np.full((truth.time.size, 3), np.nan)
    rpy[:, 2] = truth.heading
    return Reference(
        time=truth.time,
        pos_e=truth.pos_e,
        vel_e=np.gradient(truth.pos_e, truth.time, axis=0),
        rpy=rpy,
        lever_b=np.zeros(3),
        point="not documented",
        source="NovAtel SPAN, independent of the u-blox receiver",
        attitude_frame="v",
    )
