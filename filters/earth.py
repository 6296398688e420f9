"""Earth model: WGS 84 ellipsoid, Earth rate, gravity in ECEF, local axes.

Frames: `e` is ECEF, `n` is north-east-down at the given position. Coordinates come from
pymap3d; gravity is the J2 field, which is closed in ECEF, differs from Somigliana's normal
gravity by at most 1.2e-4 m/s² (12 µg, at the poles: J4), and has the simple gradient the error
model needs.
"""

from __future__ import annotations

import math

import numpy as np
import pymap3d
from numpy.typing import ArrayLike

from .rotation import FloatArray, skew

#: Semi-major axis [m] and first eccentricity squared of WGS 84.
SEMI_MAJOR_AXIS = 6378137.0
ECCENTRICITY_SQUARED = 6.69437999014e-3
#: Earth rotation rate [rad/s] (WGS 84, as in IS-GPS-200).
EARTH_RATE = 7.2921151467e-5
#: Geocentric gravitational constant [m³/s²] and second zonal harmonic of WGS 84.
GM = 3.986004418e14
J2 = 1.082629821e-3
#: Distances to the Earth's centre between which vehicles are [m]: 7 km below the ellipsoid at the
#: poles, 22 km above it at the equator.
LOWEST_RADIUS, HIGHEST_RADIUS = 6_350_000.0, 6_400_000.0
#: Speed of light [m/s].
SPEED_OF_LIGHT = 299792458.0

#: Earth rotation vector in ECEF [rad/s] and its cross-product matrix.
OMEGA_IE_E: FloatArray = np.array([0.0, 0.0, EARTH_RATE])
OMEGA_IE_SKEW: FloatArray = skew(OMEGA_IE_E)


def lla_to_ecef(lat: ArrayLike, lon: ArrayLike, height: ArrayLike) -> FloatArray:
    """Return ECEF position [m], shape (..., 3).

    Parameters
    ----------
    lat, lon : array_like
        Geodetic latitude and longitude [rad].
    height : array_like
        Height above the WGS 84 ellipsoid [m].

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.filters import lla_to_ecef
    >>> lla_to_ecef(0.0, 0.0, 0.0)  # semi-major axis of WGS 84
    array([6378137.,       0.,       0.])
    >>> lla_to_ecef(np.pi / 2, 0.0, 100.0).round(3) + 0.0  # 100 m above the pole
    array([      0.   ,       0.   , 6356852.314])
    """
    return np.stack(pymap3d.geodetic2ecef(lat, lon, height, deg=False), axis=-1)


def ecef_to_lla(pos_e: ArrayLike) -> FloatArray:
    """Return latitude [rad], longitude [rad] and ellipsoidal height [m], shape (..., 3).

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.filters import ecef_to_lla, lla_to_ecef
    >>> lla = ecef_to_lla(lla_to_ecef(np.radians(30.53), np.radians(114.36), 30.0))
    >>> print(np.degrees(lla[:2]).round(6), lla[2].round(4))
    [ 30.53 114.36] 30.0
    """
    p = np.asarray(pos_e, dtype=float)
    lla = pymap3d.ecef2geodetic(p[..., 0], p[..., 1], p[..., 2], deg=False)
    # pymap3d returns some outputs of a one-element array as scalars.
    return np.stack([np.reshape(v, p.shape[:-1]).astype(float) for v in lla], axis=-1)


def C_en_at(lat: ArrayLike, lon: ArrayLike) -> FloatArray:
    """Return C_en (NED → ECEF) at geodetic latitude and longitude [rad], shape (..., 3, 3)."""
    lat, lon = np.broadcast_arrays(np.asarray(lat, dtype=float), np.asarray(lon, dtype=float))
    sb, cb, sl, cl = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    zero = np.zeros_like(sb)
    rows = [[-sb * cl, -sl, -cb * cl], [-sb * sl, cl, -cb * sl], [cb, zero, -sb]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def C_en_of(pos_e: ArrayLike) -> FloatArray:
    """Return C_en (NED → ECEF) at an ECEF position [m], shape (..., 3, 3).

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.filters import C_en_of, lla_to_ecef
    >>> C_en = C_en_of(lla_to_ecef(0.0, 0.0, 0.0))
    >>> print(C_en.round(3) + 0.0)  # columns north, east, down: on the equator north is z
    [[ 0.  0. -1.]
     [ 0.  1.  0.]
     [ 1.  0.  0.]]
    """
    pos_e = np.asarray(pos_e, dtype=float)
    if pos_e.ndim == 1 and pos_e @ pos_e > 0.0:  # as the filter calls it
        return _one_C_en(*pos_e.tolist())
    lla = ecef_to_lla(pos_e)
    return C_en_at(lla[..., 0], lla[..., 1])


def _one_C_en(x: float, y: float, z: float) -> FloatArray:
    """Bowring (1985), iterated: to rounding wherever a vehicle is, 1e-12 at 1000 km.

    The parametric latitude β has tan β = (b/a) tan φ, and
    tan φ = (z + e'² b sin³β)/(p − e² a cos³β).
    """
    axis = math.hypot(x, y)
    b_over_a = math.sqrt(1.0 - ECCENTRICITY_SQUARED)
    b = SEMI_MAJOR_AXIS * b_over_a
    second = ECCENTRICITY_SQUARED / (1.0 - ECCENTRICITY_SQUARED)
    up, out = z, axis * b_over_a  # tan β at first as on the surface
    for _ in range(3):
        r = math.hypot(up, out)
        s, c = up / r, out / r
        up = b_over_a * (z + second * b * s**3)
        out = axis - ECCENTRICITY_SQUARED * SEMI_MAJOR_AXIS * c**3
    up /= b_over_a
    r = math.hypot(up, out)
    sb, cb = up / r, out / r
    sl, cl = (y / axis, x / axis) if axis > 0.0 else (0.0, 1.0)
    return np.array([[-sb * cl, -sl, -cb * cl], [-sb * sl, cl, -cb * sl], [cb, 0.0, -sb]])


def gravitation_e(pos_e: ArrayLike) -> FloatArray:
    """Return the gravitational acceleration (mass attraction only) in ECEF [m/s²], shape (..., 3).

    J2 field: −GM/r³ · [x(1 + c(1 − 5z²/r²)), y(…), z(1 + c(3 − 5z²/r²))], c = 3/2·J2·a²/r².
    """
    p = np.asarray(pos_e, dtype=float)
    r2 = np.sum(p * p, axis=-1, keepdims=True)
    z2 = p[..., 2:3] ** 2 / r2
    c = 1.5 * J2 * SEMI_MAJOR_AXIS**2 / r2
    factor = 1.0 + c * np.concatenate([1.0 - 5.0 * z2, 1.0 - 5.0 * z2, 3.0 - 5.0 * z2], axis=-1)
    return -GM / (r2 * np.sqrt(r2)) * factor * p


def gravity_e(pos_e: ArrayLike) -> FloatArray:
    """Return gravity (gravitation plus centrifugal acceleration) in ECEF [m/s²], shape (..., 3).

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.filters import C_en_of, gravity_e, lla_to_ecef
    >>> pos_e = lla_to_ecef(np.radians([0.0, 45.0, 90.0]), 0.0, 0.0)
    >>> np.linalg.norm(gravity_e(pos_e), axis=-1).round(4)  # equator, 45°, pole
    array([9.7803, 9.8062, 9.8321])
    >>> (C_en_of(pos_e[1]).T @ gravity_e(pos_e[1])).round(4) + 0.0  # north, east, down
    array([0.    , 0.    , 9.8062])
    """
    p = np.asarray(pos_e, dtype=float)
    if p.ndim == 1 and p @ p > 0.0:  # as the filter calls it
        return _one_gravity_e(*p.tolist())
    centrifugal = EARTH_RATE**2 * p * np.array([1.0, 1.0, 0.0])
    return gravitation_e(p) + centrifugal


def _one_gravity_e(x: float, y: float, z: float) -> FloatArray:
    r2 = x * x + y * y + z * z
    z2 = z * z / r2
    c = 1.5 * J2 * SEMI_MAJOR_AXIS**2 / r2
    scale, turning = -GM / (r2 * math.sqrt(r2)), EARTH_RATE**2
    level = scale * (1.0 + c * (1.0 - 5.0 * z2)) + turning
    return np.array([level * x, level * y, scale * (1.0 + c * (3.0 - 5.0 * z2)) * z])


def gravity_gradient_e(pos_e: ArrayLike) -> FloatArray:
    """Return d(gravity_e)/d(pos_e) [1/s²], shape (3, 3), for a point mass plus centrifugal term.

    The neglected J2 part is 0.3 % of it: far below what a fix interval can show.
    """
    p = np.asarray(pos_e, dtype=float)
    r2 = float(p @ p)
    r = np.sqrt(r2)
    gradient = GM / r**3 * (3.0 * np.outer(p, p) / r2 - np.eye(3))
    return gradient - OMEGA_IE_SKEW @ OMEGA_IE_SKEW
