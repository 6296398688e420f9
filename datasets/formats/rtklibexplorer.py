"""rtklibexplorer/GNSS_IMU: a car with an ICM-45686 and an RTK receiver (drive_0708).

``imu_*.csv`` without header: ax ay az [g], gx gy gz [deg/s], sensor clock [ms]; sensor axes as
mounted are back-right-up. ``.tag`` beside it is RTKLIB's time tag: the GPS time at which the log
was opened. ``gnss_*.pos`` is an RTKLIB solution, position and velocity.

Time, measured on the set. The velocity of an epoch is the mean over the 0.25 s before it: it
agrees with (p_k − p_{k−1})/Δt to 0.03 m/s and with the central difference to 0.10 m/s only. The
mean of two neighbours is the velocity at the epoch (0.02 m/s), and that is what the reader hands
on. Against the velocities as printed the IMU's stamps fit at 0.00 ± 0.01 s, so against the
positions they are late by 0.12 s (innovations are smallest there), the lag of about 0.1 s that
the set's author speaks of.
"""

from __future__ import annotations

import dataclasses
import struct
from pathlib import Path

import numpy as np

from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray, matrix_from_rpy
from ...filters.sensors import STANDARD_GRAVITY, ImuSpec
from ..observations import GnssFixes
from ..physics import check_gravity, check_gyro, course_of
from ..sequence import Calibration, Sequence
from ..series import ImuData, Reference
from ..text.tables import cannot_open, increasing, read_table, sampling_note
from .rtklib_pos import read_pos

_COLUMNS = ("ax", "ay", "az", "gx", "gy", "gz", "ms")
#: Sensor axes (back, right, up) to body axes: ``x_b = C_bs @ x_s``.
_C_bs = np.diag([-1.0, 1.0, -1.0])
#: Unix time of the GPS epoch; RTKLIB counts GPS time from 1970 without leap seconds.
_GTIME_OF_GPS_EPOCH = 315964800

#: From drive_config.py of the set: mounting (roll, pitch, yaw) of the sensor [deg], with
#: ``x_v = matrix_from_rpy(…)ᵀ x_s``, and places seen from the vehicle point, v axes [m].
MOUNT_RPY_DEG = (180.0, -6.79, 185.35)
IMU_V = np.array([0.0, 0.0, -0.65])
ANTENNA_V = np.array([0.0, -0.05, -0.65])
#: How well: printed to a hundredth of a degree, and not said how found [rad]; the vehicle point is
#: right below the IMU, which no rear axle was measured to be [m].
_MOUNT_SIGMA, _POINT_SIGMA = float(np.radians(1.0)), 1.0

#: How late the IMU's stamps are against the positions [s]; see above.
IMU_LAG = 0.12

ICM45686 = ImuSpec(
    name="icm45686",
    source="drive_config.py of rtklibexplorer/GNSS_IMU: 0.0038 deg/s/√Hz, 70 µg/√Hz, initial "
    "accelerometer bias 0.1 m/s²; white noise widened fivefold (gyro) and threefold "
    "(accelerometer), which brings the innovations of this drive to their σ (the box vibrates); "
    "gyro turn-on widened to 0.2 deg/s, because the set's first 25 s at rest show 0.17; in-run "
    "figures assumed",
    gyro_arw_deg_sqrth=1.14,
    gyro_bias_instability_degph=10.0,
    gyro_bias_turn_on_degph=720.0,
    accel_vrw_mps_sqrth=0.124,
    accel_bias_instability_mg=0.2,
    accel_bias_turn_on_mg=10.0,
    gyro_scale_ppm=5000.0,
    accel_scale_ppm=5000.0,
)


def is_rtklibexplorer(folder: Path) -> bool:
    """Return whether the folder holds ``imu_*.csv`` and ``gnss_*.pos``."""
    return bool(list(folder.glob("imu_*.csv"))) and bool(list(folder.glob("gnss_*.pos")))


def read_rtklibexplorer(path: str | Path, *, imu_lag: float = IMU_LAG) -> Sequence:
    """Return the drive.

    Parameters
    ----------
    path : path
        Folder with one ``imu_*.csv``, its ``.tag`` and one ``gnss_*.pos``.
    imu_lag : float
        How late the IMU's stamps are [s]; they are moved back by it.

    Raises
    ------
    DataError
        Missing or unreadable files, or data that contradict physics.
    ConfigError
        Several recordings in one folder.
    """
    folder = Path(path)
    imu_file, pos_file = _only(folder, "imu_*.csv"), _only(folder, "gnss_*.pos")
    table = read_table(imu_file, _COLUMNS, separator=",")
    clock = table.values[:, 6] * 1e-3
    increasing(table, clock, "ms")
    start = read_tag_start(imu_file.with_name(imu_file.name + ".tag"))
    imu = ImuData(
        time=start + (clock - clock[0]) - imu_lag,
        gyro_b=np.radians(table.values[:, 3:6]) @ _C_bs.T,
        accel_b=STANDARD_GRAVITY * table.values[:, :3] @ _C_bs.T,
    )
    fixes = _centred_velocity(read_pos(pos_file))
    course = course_of(fixes.pos_e, fixes.vel_e)
    repeated = int((np.diff(table.values[:, :6], axis=0) == 0.0).all(axis=1).sum())
    C_bv = _C_bs @ matrix_from_rpy(np.radians(MOUNT_RPY_DEG))
    lever_b = C_bv @ (ANTENNA_V - IMU_V)
    notes = [
        "rtklibexplorer drive: IMU back-right-up in g and deg/s turned to forward-right-down",
        f"{sampling_note(imu.time, 'IMU')}; {repeated} rows repeat the one before",
        f"{sampling_note(fixes.time, 'RTK')}, "
        f"{100.0 * float((fixes.quality == 'fixed').mean()):.1f} % fixed",
        check_gravity(imu.accel_b, file=imu_file, declared="g, back-right-up"),
        check_gyro(imu, fixes.time, course, file=imu_file, declared="deg/s, back-right-up"),
        f"first IMU sample at the tag's start time, stamps moved back by {imu_lag:g} s; velocities "
        "of neighbouring epochs averaged (each is the mean over the 0.25 s before its epoch)",
        f"mounting and lever arms from the set's configuration: rpy {MOUNT_RPY_DEG}°, antenna "
        f"{lever_b.round(3)} m from the IMU",
    ]
    reference, note = _reference(fixes, lever_b)
    return Sequence(
        name=folder.resolve().name,
        imu=imu,
        calibration=Calibration(
            imu=ICM45686,
            lever_antenna_b=lever_b,
            lever_antenna_source="drive_config.py of the set",
            C_bv=C_bv,
            lever_vehicle_b=C_bv @ -IMU_V,
            mounting_source="drive_config.py of the set",
            mounting_sigma=_MOUNT_SIGMA,
            lever_vehicle_sigma=_POINT_SIGMA,
        ),
        fixes=fixes,
        reference=reference,
        notes=(*notes, note),
    )


def read_tag_start(path: str | Path) -> float:
    """Return the start time of an RTKLIB time-tag file as GPS time [s].

    The file begins with ``TIMETAG RTKLIB`` (60 bytes), the computer's tick [ms], and the start:
    whole seconds since 1970 in GPS time and the fraction, all little-endian.
    """
    path = Path(path)
    try:
        with path.open("rb") as stream:
            head = stream.read(76)
    except FileNotFoundError:
        raise DataError(
            "time tag not found: the IMU file holds no date", file=path, remedy="copy the .tag file"
        ) from None
    except OSError as error:
        raise cannot_open(path, error) from None
    if len(head) < 76 or not head.startswith(b"TIMETAG RTKLIB"):
        raise DataError("expected an RTKLIB time tag ('TIMETAG RTKLIB …')", file=path)
    _, whole, fraction = struct.unpack_from("<IId", head, 60)
    return float(whole - _GTIME_OF_GPS_EPOCH) + fraction


def _only(folder: Path, pattern: str) -> Path:
    found = sorted(folder.glob(pattern))
    if not found:
        raise DataError(f"no {pattern} found", file=folder)
    if len(found) > 1:
        names = ", ".join(f.name for f in found)
        raise ConfigError(f"{folder}: several recordings ({names}): keep one per folder")
    return found[0]


def _centred_velocity(fixes: GnssFixes) -> GnssFixes:
    """Return the fixes with velocities that belong to their epochs; the last has none."""
    vel_e = np.full_like(fixes.vel_e, np.nan)
    vel_e[:-1] = 0.5 * (fixes.vel_e[:-1] + fixes.vel_e[1:])
    # Only where the neighbour is the next epoch, not the one after a gap.
    step = np.diff(fixes.time)
    vel_e[:-1][step > 1.5 * np.median(step)] = np.nan
    return dataclasses.replace(fixes, vel_e=vel_e)


def _reference(fixes: GnssFixes, lever_b: FloatArray) -> tuple[Reference, str]:
    """Return the fixed epochs as reference: the set has no other."""
    fixed = fixes.take(fixes.quality == "fixed")
    reference = Reference(
        time=fixed.time,
        pos_e=fixed.pos_e,
        vel_e=fixed.vel_e,
        rpy=np.full((len(fixed), 3), np.nan),
        lever_b=lever_b,
        point="antenna",
        source="the RTK-fixed epochs themselves: NOT independent of the GNSS navigated with",
    )
    return reference, (
        f"reference: the {len(fixed)} RTK-fixed epochs (not independent), antenna, no attitude"
    )
