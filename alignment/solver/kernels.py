"""Compiled loops of the fast solver; `alignment.solver.fast_compiled` puts them together.

Plain scalar loops over small arrays: numba turns them into about a microsecond per Newton step or
Cholesky factorisation, where a numpy call costs as much as all of it. Costs are in units of the
cost matrix's scale (tr Q = 1), so that tolerances are plain numbers. The mathematics is in
`alignment.solver.quartic`, what proves a rotation in `alignment.solver.margin_kernels`;
`alignment.solver.fast_numpy` does the same without a compiler.

The tables of `alignment.solver.quartic` and the kernels imported here are compiled in, and numba's
cache looks at this file only: whoever changes them must touch it.
"""

from __future__ import annotations

import numpy as np

from ...filters.compiled.jit import njit
from .margin_kernels import add_null, cholesky, null_part, quick_margin, solve_cholesky
from .quartic import GRID, GRID_FEATURES, GRID_NEAR, NORM, Z

#: Newton steps of one descent.
NEWTON_STEPS = 40
_HALF = 1.0 / np.sqrt(2.0)


@njit(cache=True)
def expand(Q, C, slope, H, J, QJ):
    """Return f(C); slope and H get gradient and Hessian of f(C·Exp(θ)). J, QJ are scratch."""
    S = QJ  # 3×3 corner used for Cᵀ mat(Qx), before QJ is needed
    f = 0.0
    for b in range(3):
        for a in range(3):
            S[a, b] = 0.0
    for b in range(4):
        for i in range(3):
            if b == 3 and i > 0:
                break
            r = 9 if b == 3 else 3 * b + i
            y = Q[r, 9]
            for m in range(3):
                for k in range(3):
                    y += Q[r, 3 * m + k] * C[k, m]
            if b == 3:
                f += y
            else:
                f += y * C[i, b]
                for a in range(3):
                    S[a, b] += C[i, a] * y
    slope[0] = 2.0 * (S[2, 1] - S[1, 2])
    slope[1] = 2.0 * (S[0, 2] - S[2, 0])
    slope[2] = 2.0 * (S[1, 0] - S[0, 1])
    trace = S[0, 0] + S[1, 1] + S[2, 2]
    for k in range(3):
        for m in range(3):
            H[k, m] = S[k, m] + S[m, k]
        H[k, k] -= 2.0 * trace
    # Columns of J: vec(C [e_k]×).
    for i in range(3):
        J[3 + i, 0] = C[i, 2]
        J[6 + i, 0] = -C[i, 1]
        J[i, 1] = -C[i, 2]
        J[6 + i, 1] = C[i, 0]
        J[i, 2] = C[i, 1]
        J[3 + i, 2] = -C[i, 0]
    for i in range(9):
        for k in range(3):
            s = 0.0
            for j in range(9):
                s += Q[i, j] * J[j, k]
            QJ[i, k] = s
    for k in range(3):
        for m in range(3):
            s = 0.0
            for i in range(9):
                s += J[i, k] * QJ[i, m]
            H[k, m] += 2.0 * s
    return f


@njit(cache=True)
def _turn(C, theta, out):
    """out ← C·Exp(θ) to second order, by the quaternion (1, θ/2)/|…|: exactly a rotation."""
    x, y, z = 0.5 * theta[0], 0.5 * theta[1], 0.5 * theta[2]
    n2 = x * x + y * y + z * z
    a = 2.0 / (1.0 + n2)
    for i in range(3):
        c0, c1, c2 = C[i, 0], C[i, 1], C[i, 2]
        along = c0 * x + c1 * y + c2 * z
        # c(I + a([u]× + uuᵀ − |u|²I)): a row times the rotation.
        out[i, 0] = c0 + a * (c1 * z - c2 * y + along * x - n2 * c0)
        out[i, 1] = c1 + a * (c2 * x - c0 * z + along * y - n2 * c1)
        out[i, 2] = c2 + a * (c0 * y - c1 * x + along * z - n2 * c2)


@njit(cache=True)
def _orthonormalise(C):
    """One Newton–Schulz step: from rounding errors to the last digit."""
    for _ in range(2):
        a = np.empty((3, 3))
        for i in range(3):
            for j in range(3):
                s = 0.0
                for k in range(3):
                    s += C[k, i] * C[k, j]
                a[i, j] = -0.5 * s
            a[i, i] += 1.5
        for i in range(3):
            c0, c1, c2 = C[i, 0], C[i, 1], C[i, 2]
            for j in range(3):
                C[i, j] = c0 * a[0, j] + c1 * a[1, j] + c2 * a[2, j]


@njit(cache=True)
def newton(Q, C):
    """Descend from C in place; return cost and steps."""
    slope, trial_slope, step = np.empty(3), np.empty(3), np.empty(3)
    H, trial_H, L = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    J, QJ, trial = np.zeros((9, 3)), np.empty((9, 3)), np.empty((3, 3))
    f = expand(Q, C, slope, H, J, QJ)
    scale = abs(H[0, 0]) + abs(H[1, 1]) + abs(H[2, 2]) + 1e-300
    damping, steps = 0.0, 0
    while steps < NEWTON_STEPS:
        if max(abs(slope[0]), abs(slope[1]), abs(slope[2])) <= 1e-15 * scale:
            break
        steps += 1
        accepted = False
        length = 0.0
        for _ in range(12):
            for i in range(3):
                for j in range(3):
                    L[i, j] = H[i, j]
                L[i, i] += damping
                step[i] = -slope[i]
            if cholesky(L):
                solve_cholesky(L, step)
                length = np.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
                if length < 0.9:
                    _turn(C, step, trial)
                    trial_f = expand(Q, trial, trial_slope, trial_H, J, QJ)
                    if trial_f <= f + 1e-15:
                        accepted = True
                        break
            damping = max(4.0 * damping, 0.02 * scale)
        if not accepted:
            break
        f = trial_f
        for i in range(3):
            slope[i] = trial_slope[i]
            for j in range(3):
                C[i, j] = trial[i, j]
                H[i, j] = trial_H[i, j]
        # An undamped step this small squares to rounding: the next one would only wander.
        if damping == 0.0 and length < 1e-8:
            break
        damping = 0.1 * damping if damping > 1e-3 * scale else 0.0
    _orthonormalise(C)
    return expand(Q, C, slope, H, J, QJ), steps


@njit(cache=True)
def smallest_gram(Q, C, X, slope):
    """X ← the Gram matrix of f − f(C) nearest to zero; slope ← what remains in the row of w²."""
    TZ, G = np.zeros((10, 10)), np.empty((10, 10))
    for b in range(3):
        for i in range(3):
            for m in range(10):
                s = 0.0
                for j in range(3):
                    s += C[i, j] * Z[3 * b + j, m]
                TZ[3 * b + i, m] = s
    for m in range(10):
        TZ[9, m] = Z[9, m]
    y = np.empty(10)
    for m in range(10):
        for i in range(10):
            s = 0.0
            for j in range(10):
                s += Q[i, j] * TZ[j, m]
            y[i] = s
        for n in range(m + 1):
            s = 0.0
            for i in range(10):
                s += TZ[i, n] * y[i]
            G[n, m] = s
            G[m, n] = s
    f = G[0, 0]
    for i in range(10):
        for j in range(10):
            G[i, j] -= f * NORM[i] * NORM[j]
    for i in range(9):
        for j in range(9):
            X[i, j] = G[i + 1, j + 1]
    for i in range(3):
        X[i, i] += G[0, 4 + i]
        slope[i] = G[0, 1 + i]
    X[0, 1] += _HALF * G[0, 7]
    X[0, 2] += _HALF * G[0, 8]
    X[1, 2] += _HALF * G[0, 9]
    X[1, 0], X[2, 0], X[2, 1] = X[0, 1], X[0, 2], X[1, 2]
    for k in range(14):
        add_null(X, k, -null_part(X, k))


@njit(cache=True)
def guess(Q, C, X, slope):
    """Fill X and slope as `smallest_gram`; return the margin that X proves as it is, or −inf."""
    smallest_gram(Q, C, X, slope)
    return quick_margin(X)


@njit(cache=True)
def _grid_costs(Q, costs):
    entries, c = np.empty(55), 0
    for i in range(10):
        for j in range(i + 1):
            entries[c] = Q[i, j]
            c += 1
    for a in range(costs.size):
        s = 0.0
        for k in range(55):
            s += GRID_FEATURES[a, k] * entries[k]
        costs[a] = s


@njit(cache=True)
def _next_start(costs, C):
    """C ← the cheapest grid rotation left, whose neighbours are struck off; False if none is."""
    best, lowest = -1, np.inf
    for a in range(costs.size):
        if costs[a] < lowest:
            best, lowest = a, costs[a]
    if best < 0:
        return False
    for a in range(costs.size):
        if GRID_NEAR[a, best]:
            costs[a] = np.inf
    for i in range(3):
        for j in range(3):
            C[i, j] = GRID[best, i, j]
    return True


@njit(cache=True)
def bottoms(Q, left, first, last, C, f):
    """Descend from the grid's starts `first` … `last` − 1, the cheapest first.

    C[k] and f[k] receive what is below start k, `left` the costs of the grid rotations that are
    left. Returns how many starts there have been so far, fewer than `last` where the grid has no
    more, and the Newton steps from these.
    """
    if first == 0:
        _grid_costs(Q, left)
    steps = 0
    for k in range(first, last):
        if not _next_start(left, C[k]):
            return k, steps
        f[k], more = newton(Q, C[k])
        steps += more
    return last, steps


@njit(cache=True)
def distinct(C, f, n):
    """Keep the distinct of the first n rotations, each at its lowest cost; return their number."""
    kept = 0
    for k in range(n):
        m = 0
        while m < kept:
            s = 0.0
            for i in range(3):
                for j in range(3):
                    s += C[k, i, j] * C[m, i, j]
            if s > 2.9999:  # 0.6°
                break
            m += 1
        if m == kept or f[k] < f[m]:
            f[m] = f[k]
            for i in range(3):
                for j in range(3):
                    C[m, i, j] = C[k, i, j]
        kept = max(kept, m + 1)
    return kept
