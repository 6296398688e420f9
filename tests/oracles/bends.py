"""A level drive at 10 m/s through bends, in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certnav.filters.earth import C_en_at, lla_to_ecef
from certnav.filters.rotation import FloatArray

SPEED = 10.0
LAT, LON = np.radians([30.5, 114.4])


@dataclass(frozen=True, eq=False)
class Bends:
    """The drive at the times of its IMU, in forward-right-down axes, SI and radians."""

    time: FloatArray
    heading: FloatArray
    vel_n: FloatArray
    pos_e: FloatArray
    gyro_b: FloatArray
    accel_b: FloatArray


def bends(start: float, rate: float, duration: float) -> Bends:
    """Return the drive from `start` on, a sample every 1/`rate` s."""
    time = start + np.arange(0.0, duration, 1.0 / rate)
    since = time - start
    heading, yaw_rate = 1.2 * np.sin(since / 3.0), 0.4 * np.cos(since / 3.0)
    zero = np.zeros(time.size)
    vel_n = SPEED * np.column_stack([np.cos(heading), np.sin(heading), zero])
    middle = 0.5 * (vel_n[1:] + vel_n[:-1]) / rate
    path_n = np.vstack([np.zeros(3), np.cumsum(middle, axis=0)])
    return Bends(
        time,
        heading,
        vel_n,
        lla_to_ecef(LAT, LON, 20.0) + path_n @ C_en_at(LAT, LON).T,
        np.column_stack([zero, zero, yaw_rate]),
        np.column_stack([zero, SPEED * yaw_rate, zero - 9.79]),
    )
