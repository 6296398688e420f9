"""How far from the optimum a rotation can be that the data do not exclude: proved, not sampled.

The region is every R with f(R) ≤ f(C) + T, T a quantile of χ². With w = cos(θ/2), θ the angle
between R and C, it is enough to prove on all of SO(3)

    f(R) − f(C) ≥ T (1 − w²) + c w² (1 − w²),

for then f(R) ≤ f(C) + T leaves only w² ≥ 1 − T/c. Near C the right side is (c + T)θ²/4, so that c
reaches 2λ_min(Hessian) − T where curvature alone decides, and the bound is that of the ellipsoid's
longest axis; a second basin, a mirror or a flat valley within T makes it larger, or 180°.

Both terms on the right are diagonal Gram matrices on the monomials (w u, u u) of
`alignment.solver.quartic`, with |q| = 1: w²(1 − w²) = w²|u|² and 1 − w² = |u|²(w² + |u|²). The
largest c is therefore the barrier method of the certificate with another right-hand side.
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincinv

from ...filters.errors import ConfigError
from ...filters.rotation import FloatArray
from .fast_solver import ROUNDING, FastMinimum, chosen_backend

#: Gram matrices of w²|u|² and of |u|²: |w u|² = ½ of the first three monomials squared.
_INNER: FloatArray = np.array([0.5] * 3 + [0.0] * 6)
_OUTER: FloatArray = np.array([0.5] * 3 + [1.0] * 6)
#: T is proved this much larger, and by as many roundings of Q: room for these and for what is left
#: of the gradient.
_ROOM, _ROUNDINGS = 1e-3, 4.0


def region_threshold(probability: float = 0.9973, dof: int = 3) -> float:
    """Return T, the quantile of χ²: 14.2 for 3σ and the three angles.

    With `dof` 9 it bounds f(truth) − f(C) whatever the shape of f, since no minimum over
    rotations is lower than that over all vec(C) in R⁹; with 3 it is the usual linearisation.
    """
    return float(2.0 * gammaincinv(0.5 * dof, probability))  # chi2.ppf takes ten times as long


def attitude_bound(minimum: FastMinimum, threshold: float, *, backend: str | None = None) -> float:
    """Return an angle that no rotation with f ≤ f(C) + threshold exceeds [rad].

    Parameters
    ----------
    minimum : FastMinimum
        Of a cost in χ² units.
    threshold : float
        T > 0.
    backend : {'numba', 'numpy'}, optional

    Returns
    -------
    float
        π if nothing smaller can be proved: the optimum is not proved, or rotations right across
        the group cost less than T more.
    """
    if not threshold > 0.0:
        raise ConfigError(f"attitude bound: expected a threshold > 0, found {threshold:g}")
    solver = chosen_backend(backend)
    X = minimum.gram / minimum.scale
    T = threshold * (1.0 + _ROOM) / minimum.scale + _ROUNDINGS * ROUNDING
    # Far from C the condition reads t ≥ T; twice that starts the second stage well inside.
    t, X, _ = solver.largest_margin(X, 2.0 * T, T)
    if not t > T + ROUNDING:
        return np.pi
    limit = 2.0 * float(np.linalg.eigvalsh(X[:3, :3])[0])
    X = X - T * np.diag(_OUTER)
    start, tolerance = T - 0.5 * limit, 1e-3 * limit
    c, X, _ = solver.barrier(X, _INNER, start, np.inf, -np.inf, tolerance)
    return _proved(X, c - tolerance, T, threshold / minimum.scale, minimum)


def _proved(X: FloatArray, c: float, T: float, threshold: float, minimum: FastMinimum) -> float:
    """Return the angle that the matrix at hand proves, whoever found it."""
    if not c > T:
        return np.pi
    t = float(np.linalg.eigvalsh(X - c * np.diag(_INNER))[0]) - ROUNDING
    slope = float(np.linalg.norm(minimum.slope)) / (np.sqrt(2.0) * minimum.scale) + ROUNDING
    if not (t > 0.0 and slope * slope / t + ROUNDING < T - threshold):
        return np.pi
    return 2.0 * float(np.arcsin(np.sqrt(T / c)))
