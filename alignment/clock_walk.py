"""Rows under a clock that walks, made independent in one pass.

Of the covariance diag(σ²) + q²·min(tᵢ, tⱼ) the inverse Cholesky factor is, row by row in the
order of time, a scalar Kalman filter for the drift: what is left of a row after its prediction,
over its standard deviation. Time and memory grow with the rows, not with their cube and square.
"""

from __future__ import annotations

import numpy as np

from ..filters.compiled.jit import njit
from ..filters.rotation import FloatArray


def independent(matrix: FloatArray, sigma: FloatArray, time: FloatArray, q: float) -> FloatArray:
    """Return `matrix` with its rows decorrelated and scaled to unit variance, shape (k, m).

    Parameters
    ----------
    matrix : ndarray, shape (k, m)
    sigma : ndarray, shape (k,)
        1σ of the rows' own noise.
    time : ndarray, shape (k,)
        In any order; the walk starts from zero at the earliest [s].
    q : float
        Growth of the walk, in units of the rows per √s.
    """
    order = np.argsort(time, kind="stable")
    out = np.empty_like(matrix)
    _filtered(matrix, sigma, time, q, order, np.zeros(matrix.shape[1]), out)
    return out


@njit(cache=True)
def _filtered(matrix, sigma, time, q, order, mean, out):
    variance, before = 0.0, time[order[0]]
    for i in order:
        variance += q * q * (time[i] - before)
        before = time[i]
        noise = sigma[i] * sigma[i]
        total = variance + noise
        gain, size = variance / total, np.sqrt(total)
        for m in range(mean.size):
            left = matrix[i, m] - mean[m]
            out[i, m] = left / size
            mean[m] += gain * left
        variance *= noise / total
