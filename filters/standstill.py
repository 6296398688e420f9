"""Does the vehicle stand? What the IMU can say to that: spread, drift of the mean, mean rate.

A car on a smooth road is as quiet as one that stands with its engine running, and so is one that
brakes evenly: quiet alone is no proof. Whoever asks holds it against a speed, and the mean force
against gravity.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .rotation import FloatArray
from .sensors import ImuSpec
from .strapdown import InertialStream

#: Spread per axis that an idling engine may add to the sensor's own noise [rad/s], [m/s²].
IDLE_GYRO, IDLE_ACCEL = np.radians(0.3), 0.15
#: Mean rate that a standing vehicle cannot have beyond its bias [rad/s].
_TURNING = np.radians(0.3)
#: Time that is looked at, and fewest samples in it.
_WINDOW, _FEWEST = 1.0, 10
#: The last part of that time, one in so many samples, and the change of specific force in it that
#: is setting off [m/s²].
_RECENT, _STEP = 5, 0.1


def own_spread(imu: ImuSpec, dt: float) -> tuple[float, float]:
    """Return 1σ of one sample's white noise, gyro [rad/s] and accelerometer [m/s²]."""
    return imu.gyro_noise_density / dt**0.5, imu.accel_noise_density / dt**0.5


def is_quiet(
    gyro_b: FloatArray, accel_b: FloatArray | None, imu: ImuSpec, dt: float, sigmas: float
) -> NDArray[np.bool_]:
    """Tell stretches in which no axis spreads more than a standing vehicle's.

    Parameters
    ----------
    gyro_b, accel_b : ndarray, shape (..., n, 3)
        Samples of each stretch [rad/s], [m/s²]; without accelerometer the gyros alone speak.
    imu : ImuSpec
    dt : float
        Sample interval [s].
    sigmas : float
        How many times the sensor's own noise counts as quiet, beside an idling engine.

    Returns
    -------
    ndarray of bool, shape (...)
    """
    own_gyro, own_accel = own_spread(imu, dt)
    quiet = (gyro_b.std(axis=-2) < sigmas * own_gyro + IDLE_GYRO).all(axis=-1)
    if accel_b is not None:
        quiet &= (accel_b.std(axis=-2) < sigmas * own_accel + IDLE_ACCEL).all(axis=-1)
    return np.asarray(quiet)


class Rest(NamedTuple):
    """Means over a second that looks like a standstill.

    Parameters
    ----------
    rate_b, force_b : ndarray, shape (3,)
        As measured [rad/s], [m/s²].
    """

    rate_b: FloatArray
    force_b: FloatArray


def at_rest(
    stream: InertialStream,
    time: float,
    imu: ImuSpec,
    gyro_bias: ArrayLike,
    sigma_gyro_bias: ArrayLike,
) -> Rest | None:
    """Return what was measured over the last second if it looks like a standstill, else None.

    Parameters
    ----------
    stream : InertialStream
    time : float
        GPS time [s].
    imu : ImuSpec
    gyro_bias, sigma_gyro_bias : array_like, shape (3,)
        What is known of the bias, and its 1σ [rad/s].

    """
    edges = stream.edges
    last = int(np.searchsorted(edges, time + 1e-9, side="right")) - 1
    first = int(np.searchsorted(edges, time - _WINDOW - 1e-9))
    if last - first < _FEWEST:
        return None
    gyro, accel = stream.gyro[first:last], stream.accel[first:last]
    dt = float(edges[last] - edges[first]) / (last - first)
    quiet = bool(is_quiet(gyro, accel, imu, dt, 2.0))
    # A car that moves off is quiet until now: has the force of the last moment changed?
    recent = max(len(accel) // _RECENT, 1)
    step = np.abs(accel[-recent:].mean(axis=0) - accel[:-recent].mean(axis=0))
    quiet &= bool((step < 4.0 * own_spread(imu, dt)[1] / recent**0.5 + _STEP).all())
    mean: FloatArray = gyro.mean(axis=0)
    limit = _TURNING + 3.0 * np.asarray(sigma_gyro_bias, dtype=float)
    still = bool((np.abs(mean - np.asarray(gyro_bias, dtype=float)) < limit).all())
    return Rest(mean, accel.mean(axis=0)) if quiet and still else None
