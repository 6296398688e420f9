"""The fast solver with a compiler: `kernels` and `margin_kernels` in their order.

The loop over starts and the call of the barrier stand here: each kernel is then compiled once, not
once more within everything that uses it.
"""

from __future__ import annotations

import numpy as np

from ...filters.rotation import FloatArray
from . import kernels, margin_kernels
from .fast_numpy import ALL_STARTS, ENOUGH, FIRST_STARTS, GAP, SAME_COST
from .quartic import GRID


def solve(Q: FloatArray) -> tuple[FloatArray, float, float, FloatArray, FloatArray, int, int, int]:
    """Minimise xᵀQx, scale 1, over the rotations.

    Returns
    -------
    C, cost, t, X, slope, starts, Newton steps, barrier steps
        As `alignment.solver.fast_numpy.solve`.
    """
    left, found, costs = np.empty(len(GRID)), np.empty((ALL_STARTS, 3, 3)), np.empty(ALL_STARTS)
    X, slope = np.empty((9, 9)), np.empty(3)
    best, t, starts, newtons, barriers = 0, -np.inf, 0, 0, 0
    fresh = False
    for k in range(ALL_STARTS):
        starts, steps = kernels.bottoms(Q, left, k, k + 1, found, costs)
        newtons += steps
        if starts > k and (k == 0 or costs[k] < costs[best] - SAME_COST):
            best, fresh = k, True
            t = kernels.guess(Q, found[k], X, slope)
            if t > 0.0:
                break
        last = starts == k or k == ALL_STARTS - 1
        if fresh and (last or k == FIRST_STARTS - 1):
            t, X, steps = largest_margin(X, ENOUGH, -2.0 * GAP)
            barriers += steps
            fresh = False
            if t > -GAP:
                break
        if last:
            break
    return found[best], float(costs[best]), t, X, slope, starts, newtons, barriers


def minima(Q: FloatArray, starts: int) -> tuple[FloatArray, FloatArray]:
    """Return the distinct minima reached from `starts` grid rotations, and their costs."""
    left, C, costs = np.empty(len(GRID)), np.empty((starts, 3, 3)), np.empty(starts)
    n = kernels.distinct(C, costs, kernels.bottoms(Q, left, 0, starts, C, costs)[0])
    order = np.argsort(costs[:n], kind="stable")
    return C[:n][order], costs[:n][order]


def largest_margin(X: FloatArray, enough: float, hopeless: float) -> tuple[float, FloatArray, int]:
    """Maximise t with X + Σ μₖNₖ ⪰ t·I; return t, the matrix and the barrier steps."""
    return barrier(X, np.ones(9), margin_kernels.feasible(X), enough, hopeless, 1e-13)


def barrier(
    X: FloatArray, E: FloatArray, s: float, enough: float, hopeless: float, gap: float
) -> tuple[float, FloatArray, int]:
    """Maximise s subject to X + Σ μₖNₖ ⪰ s·diag(E); return s, the matrix and the steps."""
    X = X.copy()
    s, steps = margin_kernels.barrier(X, E, s, enough, hopeless, gap)
    return s, X, steps
