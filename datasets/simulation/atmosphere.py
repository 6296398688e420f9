"""Delays the simulator puts on a GPS L1 signal: broadcast ionosphere, standard troposphere.

Written from the specifications and independent of RTKLIB, whose single-point positioning has
to take these very delays out again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ...filters.earth import SPEED_OF_LIGHT
from ...filters.rotation import FloatArray

#: Relative humidity of the standard atmosphere, RTKLIB's choice.
_HUMIDITY = 0.7


def klobuchar_delay(
    alpha: ArrayLike,
    beta: ArrayLike,
    second_of_day: ArrayLike,
    lla: ArrayLike,
    azimuth: ArrayLike,
    elevation: ArrayLike,
) -> FloatArray:
    """Return the broadcast-model code delay at L1 [m] (IS-GPS-200N, 20.3.3.5.2.5).

    Parameters
    ----------
    alpha, beta : array_like, shape (4,)
        Broadcast coefficients, seconds per semicircle to the power 0…3.
    second_of_day : array_like
        GPS time of day at the receiver [s].
    lla : array_like, shape (..., 3)
        Latitude, longitude [rad] and height.
    azimuth, elevation : array_like
        Clockwise from north [rad].
    """
    lat, lon = np.asarray(lla)[..., 0] / np.pi, np.asarray(lla)[..., 1] / np.pi  # semicircles
    el = np.asarray(elevation) / np.pi
    psi = 0.0137 / (el + 0.11) - 0.022
    lat_i = np.clip(lat + psi * np.cos(azimuth), -0.416, 0.416)
    lon_i = lon + psi * np.sin(azimuth) / np.cos(lat_i * np.pi)
    lat_m = lat_i + 0.064 * np.cos((lon_i - 1.617) * np.pi)
    local = np.mod(43200.0 * lon_i + np.asarray(second_of_day), 86400.0)
    powers = lat_m[..., None] ** np.arange(4)
    amplitude = np.maximum(powers @ np.asarray(alpha, dtype=float), 0.0)
    period = np.maximum(powers @ np.asarray(beta, dtype=float), 72000.0)
    x = 2.0 * np.pi * (local - 50400.0) / period
    slant = 1.0 + 16.0 * (0.53 - el) ** 3
    day = np.where(np.abs(x) < 1.57, amplitude * (1.0 - x**2 / 2.0 + x**4 / 24.0), 0.0)
    return SPEED_OF_LIGHT * slant * (5e-9 + day)


def saastamoinen_delay(lla: ArrayLike, elevation: ArrayLike) -> FloatArray:
    """Return the slant delay of the standard atmosphere [m] (Saastamoinen 1972, cosecant mapping).

    Pressure, temperature and humidity as in the RTKLIB manual ver. 2.4.2, eq. E.5.1–E.5.4.

    Parameters
    ----------
    lla : array_like, shape (..., 3)
        Latitude, longitude [rad], height [m].
    elevation : array_like
        [rad], > 0.
    """
    lat = np.asarray(lla)[..., 0]
    height = np.maximum(np.asarray(lla)[..., 2], 0.0)
    pressure = 1013.25 * (1.0 - 2.2557e-5 * height) ** 5.2568
    kelvin = 15.0 - 6.5e-3 * height + 273.16
    vapour = 6.108 * _HUMIDITY * np.exp((17.15 * kelvin - 4684.0) / (kelvin - 38.45))
    dry = 0.0022768 * pressure / (1.0 - 0.00266 * np.cos(2.0 * lat) - 0.00028 * height / 1e3)
    wet = 0.002277 * (1255.0 / kelvin + 0.05) * vapour
    return (dry + wet) / np.sin(elevation)
