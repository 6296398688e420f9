"""Which Doppler to trust when the velocity is roughly known: a prior joins the residual test.

Among themselves, n satellites check n − 4 equations, and between houses several reflected ones
may well agree with each other. A filter that knows the velocity to a decimetre per second checks
n − 1 of them, and all n if it knows the receiver's clock drift too.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..filters.fault_exclusion import chi2_limit, consistent_rows
from ..filters.rotation import FloatArray


def agreeing(H: ArrayLike, z: ArrayLike, P: ArrayLike, significance: float) -> NDArray[np.bool_]:
    """Return which whitened rows ``z = H x + ε``, x ~ N(0, P), ε ~ N(0, I), agree with the prior.

    The smallest set of rows whose absence makes the innovation pass its χ² test is left out, and
    with it every row that might as well have been the culprit (`consistent_rows`, `margin`). Where
    more than half would have to go, each row is held against the prior alone.

    Parameters
    ----------
    H : array_like, shape (n, p)
    z : array_like, shape (n,)
    P : array_like, shape (p, p)
    significance : float
        Probability that the test accuses fault-free rows.
    """
    H, z, P = (np.asarray(a, dtype=float) for a in (H, z, P))
    n, p = H.shape
    S = H @ P @ H.T + np.eye(n)
    if z @ np.linalg.solve(S, z) <= chi2_limit(significance, n):
        return np.ones(n, dtype=bool)
    # The prior as p rows of their own: x = 0 with covariance P.
    root = np.linalg.cholesky(P + 1e-12 * np.trace(P) / p * np.eye(p))
    prior = np.linalg.inv(root)
    keep = consistent_rows(
        np.vstack([H, prior]),
        np.concatenate([z, np.zeros(p)]),
        np.ones(n + p),
        significance,
        trusted=p,
        margin=_MARGIN,
    )
    if keep is not None:
        return keep[:n]
    alone: NDArray[np.bool_] = z**2 <= chi2_limit(significance, 1) * np.diag(S)
    return _together(S, z, alone, significance)


#: χ² by which the best accusation has to be better than the next one: e⁻³ in likelihood.
_MARGIN = 6.0


def _together(
    S: FloatArray, z: FloatArray, keep: NDArray[np.bool_], significance: float
) -> NDArray[np.bool_]:
    """Return `keep` if its rows agree jointly, else nothing."""
    rows = np.flatnonzero(keep)
    nis = z[rows] @ np.linalg.solve(S[np.ix_(rows, rows)], z[rows])
    return keep if nis <= chi2_limit(significance, rows.size) else np.zeros_like(keep)
