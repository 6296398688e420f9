"""The velocity of a point beside the IMU: C_eb (ω_eb × lever), for one epoch or many."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .earth import OMEGA_IE_E
from .rotation import FloatArray


def rate_over_earth(C_eb: ArrayLike, omega_b: ArrayLike) -> FloatArray:
    """Return ω_eb^b = ω_ib^b − C_be ω_ie [rad/s], shape (..., 3).

    Parameters
    ----------
    C_eb : array_like, shape (..., 3, 3)
    omega_b : array_like, shape (..., 3)
        ω_ib^b, corrected [rad/s].
    """
    C_be = np.swapaxes(np.asarray(C_eb, dtype=float), -1, -2)
    rate: FloatArray = np.asarray(omega_b, dtype=float) - C_be @ OMEGA_IE_E
    return rate


def lever_velocity(C_eb: ArrayLike, omega_eb_b: ArrayLike, lever_b: ArrayLike) -> FloatArray:
    """Return the ECEF velocity of a point at `lever_b` less the IMU's [m/s], shape (..., 3).

    Parameters
    ----------
    C_eb : array_like, shape (..., 3, 3)
    omega_eb_b : array_like, shape (..., 3)
        Rate with respect to the Earth (`rate_over_earth`) [rad/s].
    lever_b : array_like, shape (3,)
        IMU to point, body axes [m].
    """
    swing_b = np.cross(np.asarray(omega_eb_b, dtype=float), np.asarray(lever_b, dtype=float))
    return np.einsum("...ij,...j->...i", np.asarray(C_eb, dtype=float), swing_b)
