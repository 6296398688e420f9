"""Motion as the IMU and as GNSS sees it, in quantities that can be compared.

The gyro's integral is the change of course; the accelerometer's is the change of speed along, and
speed times change of course across. Course is that of the antenna, which sits ahead of the rear
axle and therefore leads the heading by their distance over speed: 0.1–0.3 s in a car.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...datasets.sequence import Sequence
from ...datasets.series import ImuData
from ...filters.rotation import FloatArray
from ...velocity.tracks import Track

#: Slower than this, a course is no direction to compare with [m/s].
COURSE_SPEED = 3.0
#: Intervals over which motion is compared [s]: short against a manoeuvre.
_INTERVAL = 1.0
#: No car accelerates faster: an increment that does is an outlier of the GNSS [m/s²].
_MAX_ACCELERATION = 12.0


@dataclass(frozen=True, eq=False)
class Inertial:
    """IMU integrals in vehicle axes (mounting applied).

    Attributes
    ----------
    time : ndarray, shape (n,)
    angle, velocity : ndarray, shape (n, 3)
        ∫ω [rad] and ∫f [m/s], vehicle axes.
    gyro : ndarray, shape (n, 3)
        [rad/s].
    """

    time: FloatArray
    angle: FloatArray
    velocity: FloatArray
    gyro: FloatArray

    def shifted(self, seconds: float) -> Inertial:
        """Return the same with `seconds` added to the stamps."""
        return Inertial(self.time + seconds, self.angle, self.velocity, self.gyro)

    def turned(self, C_ab: FloatArray) -> Inertial:
        """Return the same in axes a: ``x_a = C_ab @ x_b``."""
        if np.array_equal(C_ab, np.eye(3)):
            return self
        angle, velocity, gyro = (v @ C_ab.T for v in (self.angle, self.velocity, self.gyro))
        return Inertial(self.time, angle, velocity, gyro)


def inertial(sequence: Sequence) -> Inertial:
    """Return the IMU's integrals in vehicle axes."""
    return integrals(sequence.inertial).turned(sequence.calibration.C_bv.T)


def integrals(imu: ImuData) -> Inertial:
    """Return an IMU's integrals in its own axes."""
    step = np.diff(imu.time, prepend=imu.time[0])[:, None]
    angle, velocity = (np.cumsum(v * step, axis=0) for v in (imu.gyro_b, imu.accel_b))
    return Inertial(imu.time, angle, velocity, imu.gyro_b)


@dataclass(frozen=True, eq=False)
class Increments:
    """Motion of a track over intervals of about a second, shape (m,) each; NaN where unknown."""

    start: FloatArray
    end: FloatArray
    along: FloatArray
    across: FloatArray
    turn: FloatArray
    turning_speed: float


def increments(track: Track, heading: FloatArray | None = None) -> Increments | None:
    """Return changes of speed [m/s], speed × change of course [m/s] and of course [rad].

    `heading` replaces the course in the last, where it is known.
    """
    known = np.isfinite(track.vel_n).all(axis=1)
    if known.sum() < 10:
        return None
    time, vel = track.time[known], track.vel_n[known]
    heading = None if heading is None or not np.isfinite(heading).any() else heading[known]
    step = max(1, round(_INTERVAL / float(np.median(np.diff(time)))))
    start, end = time[:-step], time[step:]
    speed = np.hypot(vel[:, 0], vel[:, 1])
    course = np.arctan2(vel[:, 1], vel[:, 0])
    along = speed[step:] - speed[:-step]
    turn = _wrapped(course[step:] - course[:-step])
    across = 0.5 * (speed[step:] + speed[:-step]) * turn
    span = end - start
    whole = span < 1.5 * max(_INTERVAL, float(np.median(span)))
    sane = whole & (np.hypot(along, across) < _MAX_ACCELERATION * span)
    # Antennas that pass zero speed turn their course by 180°.
    fast = sane & (np.minimum(speed[step:], speed[:-step]) > COURSE_SPEED)
    if heading is not None:
        turn = _wrapped(heading[step:] - heading[:-step])
    yaw = whole if heading is not None else fast
    turning = np.abs(turn[fast]) > 0.05
    return Increments(
        start,
        end,
        np.where(sane, along, np.nan),
        np.where(fast, across, np.nan),
        np.where(yaw, turn, np.nan),
        float(np.median((speed[step:])[fast][turning])) if turning.any() else np.nan,
    )


def _wrapped(angle: FloatArray) -> FloatArray:
    return (angle + np.pi) % (2.0 * np.pi) - np.pi
