"""The longest rest of a log, as the IMU itself tells it."""

from __future__ import annotations

import numpy as np

from ..datasets.series import ImuData
from ..filters.errors import DataError
from ..filters.sensors import ImuSpec
from ..filters.standstill import is_quiet

#: A log that stands for less shows no bias instability [s].
SHORTEST = 60.0
_WINDOW = 1.0
#: Mean rate of a window that rest cannot have beyond its bias [rad/s].
_TURNING = np.radians(0.3)
#: How many times a preset's noise still counts as rest.
_QUIET = 3.0


def longest_rest(imu: ImuData, assumed: ImuSpec) -> ImuData:
    """Return the longest stretch at rest, as the IMU itself tells it.

    Parameters
    ----------
    imu : ImuData
    assumed : ImuSpec
        What is quiet: three times its white noise, beside an idling engine.

    Raises
    ------
    DataError
        If none lasts `SHORTEST`.
    """
    size = max(2, round(_WINDOW / imu.interval))
    count = len(imu) // size
    gyro = imu.gyro_b[: count * size].reshape(count, size, 3)
    accel = imu.accel_b[: count * size].reshape(count, size, 3)
    still = is_quiet(gyro, accel, assumed, imu.interval, _QUIET)
    mean = gyro.mean(axis=1)
    if still.any():
        still &= (np.abs(mean - np.median(mean[still], axis=0)) < _TURNING).all(axis=1)
    first = imu.time[: count * size : size]
    still &= np.diff(first, append=imu.time[-1]) < 1.5 * size * imu.interval  # no gap in it
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    begin, end = edges[::2], edges[1::2]
    seconds = float((end - begin).max(initial=0)) * size * imu.interval
    if seconds < SHORTEST:
        raise DataError(
            f"the longest rest lasts {seconds:.0f} s, expected {SHORTEST:g} s or more",
            remedy="log the IMU at rest for an hour or more; a noisy one needs --preset consumer",
        )
    k = int(np.argmax(end - begin))
    rows = slice(begin[k] * size, end[k] * size)
    return ImuData(imu.time[rows], imu.gyro_b[rows], imu.accel_b[rows])
