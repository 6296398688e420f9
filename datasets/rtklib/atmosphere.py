"""RTKLIB's models of what the atmosphere adds to a pseudorange."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyrtklib5 as rtk
from numpy.typing import ArrayLike

from ...filters.earth import ecef_to_lla
from ...filters.rotation import FloatArray
from .satellites import gtime, load_navigation


def troposphere_delay(time: ArrayLike, pos_e: ArrayLike, elevation: ArrayLike) -> FloatArray:
    """Return the Saastamoinen slant delay of the standard atmosphere [m], shape (n,).

    Parameters
    ----------
    time : array_like, shape (n,)
        GPS time [s].
    pos_e : array_like, shape (3,) or (n, 3)
        Receiver [m].
    elevation : array_like, shape (n,)
        [rad].
    """
    time, lla, elevation = _geometry(time, pos_e, elevation)
    position, azel = rtk.Arr1Ddouble(3), rtk.Arr1Ddouble(2)
    out = np.empty(time.size)
    for k in range(time.size):
        position[0], position[1], position[2] = lla[k]
        azel[0], azel[1] = 0.0, elevation[k]
        out[k] = rtk.tropmodel(gtime(time[k]), position, azel, 0.7)
    return out


def ionosphere_delay(
    navigation: Sequence[str | Path],
    time: ArrayLike,
    pos_e: ArrayLike,
    azimuth: ArrayLike,
    elevation: ArrayLike,
) -> FloatArray:
    """Return the Klobuchar code delay at GPS L1 [m], shape (n,).

    Parameters
    ----------
    navigation : sequence of path
        The first file with GPS coefficients provides them; without any, RTKLIB's default set.
    time, pos_e, elevation
        As for `troposphere_delay`.
    azimuth : array_like, shape (n,)
        Clockwise from north [rad].

    Other frequencies: times (λ/λ_L1)².
    """
    return klobuchar(load_navigation(navigation), time, pos_e, azimuth, elevation)


def klobuchar(
    nav: Any, time: ArrayLike, pos_e: ArrayLike, azimuth: ArrayLike, elevation: ArrayLike
) -> FloatArray:
    time, lla, azimuth, elevation = _geometry(time, pos_e, azimuth, elevation)
    position, azel = rtk.Arr1Ddouble(3), rtk.Arr1Ddouble(2)
    out = np.empty(time.size)
    for k in range(time.size):
        position[0], position[1], position[2] = lla[k]
        azel[0], azel[1] = azimuth[k], elevation[k]
        out[k] = rtk.ionmodel(gtime(time[k]), nav.ion_gps, position, azel)
    return out


def _geometry(time: ArrayLike, pos_e: ArrayLike, *angles: ArrayLike) -> list[FloatArray]:
    lla = ecef_to_lla(pos_e)
    arrays = np.broadcast_arrays(
        *(np.asarray(a, dtype=float) for a in (time, *angles)), lla[..., 0]
    )
    n = arrays[0].size
    lla = np.broadcast_to(lla, (n, 3)) if lla.ndim == 1 else lla
    return [np.atleast_1d(arrays[0]), lla.reshape(n, 3), *map(np.atleast_1d, arrays[1:-1])]
