"""The largest set of linear equations that agree with each other: chi-square fault exclusion.

For ``z = H x + ε`` with independent ε of known σ, faults make the weighted residual sum exceed
its chi-square limit. Of all sets of equations to leave out, the smallest that passes the test
is taken, and of several equally small ones the best fitting.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .rotation import FloatArray


@lru_cache(maxsize=256)
def chi2_limit(significance: float, dof: int) -> float:
    """Return what chi-square with `dof` exceeds with probability `significance`; 0 dof: inf."""
    from scipy.special import chdtri  # slow to import

    return float(chdtri(dof, significance)) if dof > 0 else np.inf


def consistent_rows(
    H: ArrayLike,
    z: ArrayLike,
    sigma: ArrayLike,
    significance: float,
    accept: Callable[[NDArray[np.bool_]], bool] = lambda keep: True,
    trusted: int = 0,
    margin: float = 0.0,
) -> NDArray[np.bool_] | None:
    """Return the mask of the largest consistent set of rows, or None if it cannot be told.

    Parameters
    ----------
    H : array_like, shape (n, p)
    z, sigma : array_like, shape (n,)
        Measurements (or their residuals from any linearisation) and their 1σ.
    significance : float
        Probability that the test accuses fault-free rows.
    accept : callable
        Last word on a mask that passes the test, for conditions beside it (geometry).
    trusted : int
        So many rows, the last ones, are never accused: what is known beforehand.
    margin : float
        Rows accused by sets of the same size whose χ² is not worse than the best one's by this
        much are left out too: any of them may be the culprit.

    Notes
    -----
    All sets of one, two and three rows are tried; if none will do, the best three go and the
    search starts again. m faults are told apart only if n − p ≥ 2m; beyond that: None.
    """
    H, z, sigma = (np.asarray(a, dtype=float) for a in (H, z, sigma))
    n, p = H.shape
    h = H / sigma[:, None]
    y = z / sigma
    y = y - h @ np.linalg.lstsq(h, y, rcond=None)[0]  # small numbers: no cancellation below
    keep = np.ones(n, dtype=bool)
    if y @ y <= chi2_limit(significance, n - p) and accept(keep):
        return keep
    while True:
        inside = np.flatnonzero(keep)
        suspects = inside[inside < n - trusted]
        for count in (1, 2, 3):
            gone = n - inside.size + count
            if n - p < 2 * gone or suspects.size < count:
                return None
            sets = suspects[_combinations(suspects.size, count)]
            chi2 = _chi2_without(h, y, inside, sets)
            order = np.argsort(chi2)
            for candidate in order[chi2[order] <= chi2_limit(significance, n - p - gone)]:
                trial = keep.copy()
                trial[sets[candidate]] = False
                if margin:
                    trial[sets[chi2 <= chi2[candidate] + margin]] = False
                if accept(trial):
                    return trial
        keep[sets[order[0]]] = False


def _chi2_without(
    h: FloatArray, y: FloatArray, inside: NDArray[np.int64], sets: NDArray[np.int64]
) -> FloatArray:
    """Return chi-square of the rows `inside` without each of `sets` (m, k), shape (m,)."""
    normal = h[inside].T @ h[inside]
    # The ridge lets sets through that leave too little to solve; `accept` judges the chosen one.
    normal = normal + 1e-12 * np.trace(normal) * np.eye(h.shape[1])
    out = h[sets]
    reduced = normal - np.einsum("mki,mkj->mij", out, out)
    right = h[inside].T @ y[inside] - np.einsum("mki,mk->mi", out, y[sets])
    explained = np.einsum("mi,mi->m", right, np.linalg.solve(reduced, right[..., None])[..., 0])
    return y[inside] @ y[inside] - np.sum(y[sets] ** 2, axis=1) - explained


@lru_cache(maxsize=128)
def _combinations(n: int, count: int) -> NDArray[np.int64]:
    return np.array(list(itertools.combinations(range(n), count)), dtype=np.int64)
