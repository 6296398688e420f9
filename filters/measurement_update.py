"""The Kalman measurement update of an error state that is zero before it, twice.

`with_filterpy` is filterpy's extended Kalman filter, and the reference. `compiled` is the same
arithmetic, the gain from a Cholesky factor, in a few microseconds: filterpy takes some seventy
an update and, with scipy.stats behind it, longer to import than an hour of data takes to filter.
The tests hold one against the other; `filters.ekf.ErrorStateFilter` can be told which to use.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from .compiled.jit import njit
from .errors import DataError
from .measurements import Measurement
from .rotation import FloatArray

#: Takes a covariance and a measurement; returns the error state and its covariance.
Update = Callable[[FloatArray, Measurement], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of one measurement.

    Parameters
    ----------
    accepted : bool
    whitened : ndarray, shape (m,)
        L⁻¹z with LLᵀ = S = HPHᵀ + R.
    nis : float
        Normalised innovation squared, zᵀS⁻¹z.
    limit : float
        The gate that `nis` was held against.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.filters import Outcome
    >>> z, S = np.array([2.0, 0.0, 0.0]), 4.0 * np.eye(3)
    >>> whitened = np.linalg.solve(np.linalg.cholesky(S), z)
    >>> outcome = Outcome(True, whitened, float(whitened @ whitened), limit=16.3)
    >>> outcome.nis  # one σ off in one of three axes
    1.0
    """

    accepted: bool
    whitened: FloatArray
    nis: float
    limit: float


@lru_cache(maxsize=64)
def gate_limit(dof: int, probability: float) -> float:
    """Return the χ² value that a correct innovation of `dof` exceeds with `probability`."""
    from scipy.special import chdtri

    return float(chdtri(dof, probability)) if probability > 0.0 else float("inf")


def innovation(P: FloatArray, measurement: Measurement) -> tuple[FloatArray, float]:
    """Return the whitened innovation L⁻¹z, LLᵀ = S = HPHᵀ + R, and its square, the NIS.

    Raises
    ------
    DataError
        If S is not positive definite.
    """
    z, H, R = _contiguous(measurement)
    L, PHt, whitened = np.empty(R.shape), np.empty(H.T.shape), np.empty(z.shape)
    _check(_whiten(P, z, H, R, PHt, L, whitened))
    return whitened, float(whitened @ whitened)


def compiled(P: FloatArray, measurement: Measurement) -> tuple[FloatArray, FloatArray]:
    """Return error state and covariance after a measurement (Joseph form), compiled.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance before it.
    measurement : Measurement

    Returns
    -------
    x : ndarray, shape (n,)
    P : ndarray, shape (n, n)
    """
    z, H, R = _contiguous(measurement)
    x, after = np.empty(P.shape[0]), np.empty(P.shape)
    _check(_joseph(np.ascontiguousarray(P), z, H, R, x, after))
    return x, after


def with_filterpy(P: FloatArray, measurement: Measurement) -> tuple[FloatArray, FloatArray]:
    """Return the same from filterpy's `ExtendedKalmanFilter`."""
    from filterpy.kalman import ExtendedKalmanFilter  # slow to import

    ekf = ExtendedKalmanFilter(dim_x=P.shape[0], dim_z=measurement.z.size)
    ekf.x, ekf.P = np.zeros(P.shape[0]), P
    ekf.update(
        measurement.z,
        HJacobian=lambda _: measurement.H,
        Hx=lambda _: np.zeros(measurement.z.size),
        R=measurement.R,
    )
    return ekf.x, 0.5 * (ekf.P + ekf.P.T)


def turned(C: FloatArray, rotvec: FloatArray) -> FloatArray:
    """Return C exp(rotvec×), shape (3, 3), for one rotation vector [rad]."""
    out = np.empty((3, 3))
    _turn(np.ascontiguousarray(C), np.ascontiguousarray(rotvec), out)
    return out


def _contiguous(measurement: Measurement) -> tuple[FloatArray, FloatArray, FloatArray]:
    z, H, R = measurement.z, measurement.H, measurement.R
    return np.ascontiguousarray(z), np.ascontiguousarray(H), np.ascontiguousarray(R)


def _check(positive_definite: bool) -> None:
    if not positive_definite:
        raise DataError(
            "filter: the covariance of an innovation is not positive definite",
            remedy="check units and axes of the IMU, and the IMU preset",
        )


@njit(cache=True)
def _turn(C, rotvec, out):
    """Rodrigues' formula, as `filters.rotation.matrix_from_rotvec`."""
    x, y, z = rotvec[0], rotvec[1], rotvec[2]
    n2 = x * x + y * y + z * z
    if n2 < 1e-8:
        a, b = 1.0 - n2 / 6.0, 0.5 - n2 / 24.0
    else:
        n = np.sqrt(n2)
        a, b = np.sin(n) / n, (1.0 - np.cos(n)) / n2
    for i in range(3):
        c0, c1, c2 = C[i, 0], C[i, 1], C[i, 2]
        # C (I + a φ× + b φ×φ×), row by row: c φ× = c × φ … twice.
        u0, u1, u2 = c1 * z - c2 * y, c2 * x - c0 * z, c0 * y - c1 * x
        out[i, 0] = c0 + a * u0 + b * (u1 * z - u2 * y)
        out[i, 1] = c1 + a * u1 + b * (u2 * x - u0 * z)
        out[i, 2] = c2 + a * u2 + b * (u0 * y - u1 * x)


@njit(cache=True)
def _whiten(P, z, H, R, PHt, L, whitened):
    """Fill PHᵀ, the Cholesky factor of S and L⁻¹z; return whether S is positive definite."""
    n, m = P.shape[0], z.size
    for i in range(n):
        for a in range(m):
            s = 0.0
            for j in range(n):
                s += P[i, j] * H[a, j]
            PHt[i, a] = s
    for a in range(m):
        for b in range(a + 1):
            s = R[a, b]
            for i in range(n):
                s += H[a, i] * PHt[i, b]
            for k in range(b):
                s -= L[a, k] * L[b, k]
            if a > b:
                L[a, b] = s / L[b, b]
            elif s > 0.0:
                L[a, a] = np.sqrt(s)
            else:
                return False
        s = z[a]
        for k in range(a):
            s -= L[a, k] * whitened[k]
        whitened[a] = s / L[a, a]
    return True


@njit(cache=True)
def _joseph(P, z, H, R, x, after):
    """x ← Kz, after ← (I − KH)P(I − KH)ᵀ + KRKᵀ; return whether S is positive definite."""
    n, m = P.shape[0], z.size
    PHt, L, whitened = np.empty((n, m)), np.empty((m, m)), np.empty(m)
    if not _whiten(P, z, H, R, PHt, L, whitened):
        return False
    K = np.empty((n, m))  # PHᵀ S⁻¹, by two triangular solves
    for i in range(n):
        for a in range(m):
            s = PHt[i, a]
            for k in range(a):
                s -= L[a, k] * K[i, k]
            K[i, a] = s / L[a, a]
        for a in range(m - 1, -1, -1):
            s = K[i, a]
            for k in range(a + 1, m):
                s -= L[k, a] * K[i, k]
            K[i, a] = s / L[a, a]
        x[i] = 0.0
        for a in range(m):
            x[i] += K[i, a] * z[a]
    # A = (I − KH)P; then A(I − KH)ᵀ + KRKᵀ = A − (AHᵀ − KR)Kᵀ.
    for i in range(n):
        for j in range(n):
            s = P[i, j]
            for a in range(m):
                s -= K[i, a] * PHt[j, a]
            after[i, j] = s
    B = np.empty((n, m))
    for i in range(n):
        for a in range(m):
            s = 0.0
            for j in range(n):
                s += after[i, j] * H[a, j]
            for b in range(m):
                s -= K[i, b] * R[b, a]
            B[i, a] = s
    for i in range(n):
        for j in range(n):
            s = after[i, j]
            for a in range(m):
                s -= B[i, a] * K[j, a]
            after[i, j] = s
    for i in range(n):
        for j in range(i):
            s = 0.5 * (after[i, j] + after[j, i])
            after[i, j] = s
            after[j, i] = s
    return True
