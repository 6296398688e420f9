"""Compiled loops over Gram matrices: the largest margin t that multipliers can prove.

X + Σ μₖNₖ ⪰ t·I over the fourteen μ, first by trying, then by a barrier method. Scalar loops, as in
`alignment.solver.kernels`, which finds the rotations; the mathematics is in
`alignment.solver.quartic`.

The tables of `alignment.solver.quartic` are compiled in as constants, and numba's cache looks at
the file of a kernel only: whoever changes them must touch this one, and `kernels` with it.
"""

from __future__ import annotations

import numpy as np

from ...filters.compiled.jit import njit
from .quartic import NULL_GRAMS

#: Values of t tried on the first guess, one Cholesky factorisation each; the last is enough for
#: uniqueness in floating point (`alignment.solver.fast_solver`), what is less is maximised first.
MARGINS = np.array([1e-2, 1e-4, 1e-6, 1e-8])
BARRIER_STEPS = 80


def _sparse_nulls():
    """Return row, column, value of the upper triangles of the Nₖ, three at most, and counts."""
    row, column = np.zeros((14, 3), np.int64), np.zeros((14, 3), np.int64)
    value, count = np.zeros((14, 3)), np.zeros(14, np.int64)
    for k, N in enumerate(NULL_GRAMS):
        for i, j in zip(*np.nonzero(np.triu(N)), strict=True):
            row[k, count[k]], column[k, count[k]], value[k, count[k]] = i, j, N[i, j]
            count[k] += 1
    return row, column, value, count


_ROW, _COLUMN, _VALUE, _COUNT = _sparse_nulls()


@njit(cache=True)
def cholesky(A):
    """Factorise the lower triangle in place; False if A is not positive definite."""
    n = A.shape[0]
    for j in range(n):
        s = A[j, j]
        for k in range(j):
            s -= A[j, k] * A[j, k]
        if not s > 0.0:
            return False
        d = np.sqrt(s)
        A[j, j] = d
        for i in range(j + 1, n):
            s = A[i, j]
            for k in range(j):
                s -= A[i, k] * A[j, k]
            A[i, j] = s / d
    return True


@njit(cache=True)
def solve_cholesky(L, b):
    """b ← (LLᵀ)⁻¹ b."""
    n = L.shape[0]
    for i in range(n):
        s = b[i]
        for k in range(i):
            s -= L[i, k] * b[k]
        b[i] = s / L[i, i]
    for i in range(n - 1, -1, -1):
        s = b[i]
        for k in range(i + 1, n):
            s -= L[k, i] * b[k]
        b[i] = s / L[i, i]


@njit(cache=True)
def _inverse(L, Li, W):
    """W ← (LLᵀ)⁻¹ and Li ← L⁻¹."""
    for j in range(9):
        Li[j, j] = 1.0 / L[j, j]
        for i in range(j + 1, 9):
            s = 0.0
            for k in range(j, i):
                s -= L[i, k] * Li[k, j]
            Li[i, j] = s / L[i, i]
    for i in range(9):
        for j in range(i + 1):
            s = 0.0
            for k in range(i, 9):
                s += Li[k, i] * Li[k, j]
            W[i, j] = s
            W[j, i] = s


@njit(cache=True)
def add_null(X, k, amount):
    for c in range(_COUNT[k]):
        p, q = _ROW[k, c], _COLUMN[k, c]
        X[p, q] += amount * _VALUE[k, c]
        if p != q:
            X[q, p] += amount * _VALUE[k, c]


@njit(cache=True)
def null_part(X, k):
    """Return ⟨Nₖ, X⟩."""
    s = 0.0
    for c in range(_COUNT[k]):
        p, q = _ROW[k, c], _COLUMN[k, c]
        s += _VALUE[k, c] * X[p, q] * (1.0 if p == q else 2.0)
    return s


@njit(cache=True)
def _definite(X, E, s, L):
    """Factorise X − s·diag(E) into L; False if it is not positive definite."""
    for i in range(9):
        for j in range(i + 1):
            L[i, j] = X[i, j]
        L[i, i] -= s * E[i]
    return cholesky(L)


@njit(cache=True)
def quick_margin(X):
    """Return the largest of MARGINS with X ⪰ t·I, or −inf."""
    L, ones = np.empty((9, 9)), np.ones(9)
    for t in MARGINS:
        if _definite(X, ones, t, L):
            return t
    return -np.inf


@njit(cache=True)
def barrier(X, E, s, enough, hopeless, gap):
    """Maximise s subject to X + Σ μₖNₖ ⪰ s·diag(E) by a log-barrier method; X is changed in place.

    `s` must be strictly feasible, and well inside: a start at the edge sets the barrier's weight
    so high that the path is followed in hundreds of crawling steps. Ends with s ≥ enough, with s
    within `gap` of the maximum, or when that is sure to stay below `hopeless`.

    Returns s and the number of steps.
    """
    L, Li, W = np.zeros((9, 9)), np.zeros((9, 9)), np.empty((9, 9))
    V, D = np.empty((9, 9)), np.empty((9, 9))
    H, slope, step = np.empty((15, 15)), np.empty(15), np.empty(15)
    if not _definite(X, E, s, L):
        return -np.inf, 0
    weight = 0.0
    for steps in range(1, BARRIER_STEPS + 1):
        _inverse(L, Li, W)
        pull = 0.0
        for i in range(9):
            pull += W[i, i] * E[i]
            for j in range(i + 1):
                a = 0.0
                for k in range(9):
                    a += W[i, k] * E[k] * W[k, j]
                V[i, j] = a
                V[j, i] = a
        if weight == 0.0:
            weight = pull
        _barrier_derivatives(W, V, E, H, slope)
        slope[14] = pull - weight
        for i in range(15):
            step[i] = -slope[i]
        if cholesky(H):
            solve_cholesky(H, step)
        elif not _step_by_reflections(Li, E, weight, step):
            return s, steps
        decrement = 0.0
        for i in range(15):
            decrement -= slope[i] * step[i]
        for i in range(9):
            for j in range(9):
                D[i, j] = 0.0
        for k in range(14):
            add_null(D, k, step[k])
        value = -weight * s
        for i in range(9):
            value += 2.0 * np.log(Li[i, i])
        # Armijo on the barrier itself: staying definite is not enough to converge.
        length, accepted = 1.0, False
        for _ in range(60):
            for i in range(9):
                for j in range(i + 1):
                    L[i, j] = X[i, j] + length * D[i, j]
                L[i, i] -= (s + length * step[14]) * E[i]
            if cholesky(L):
                trial = -weight * (s + length * step[14])
                for i in range(9):
                    trial -= 2.0 * np.log(L[i, i])
                if trial <= value - 0.1 * length * decrement + 1e-9 * abs(value):
                    accepted = True
                    break
            length *= 0.6
        if not accepted:
            return s, steps
        for i in range(9):
            for j in range(9):
                X[i, j] += length * D[i, j]
        s += length * step[14]
        if s >= enough:
            return s, steps
        # On the central path: the duality gap there is 9/weight.
        if length == 1.0 and decrement < 1.0:
            if 9.0 / weight < gap or s + 20.0 / weight < hopeless:
                return s, steps
            weight *= 60.0
    return s, BARRIER_STEPS


@njit(cache=True)
def _barrier_derivatives(W, V, E, H, slope):
    """Gradient (all but the last entry) and Hessian of −log det in (μ, s)."""
    s = 0.0
    for i in range(9):
        s += V[i, i] * E[i]
    H[14, 14] = s
    for k in range(14):
        s = 0.0
        s2 = 0.0
        for c in range(_COUNT[k]):
            p, q = _ROW[k, c], _COLUMN[k, c]
            v = _VALUE[k, c] * (1.0 if p == q else 2.0)
            s += v * W[p, q]
            s2 += v * V[p, q]
        slope[k] = -s
        H[14, k] = -s2
        for m in range(k + 1):
            a = 0.0
            for c in range(_COUNT[k]):
                p, q = _ROW[k, c], _COLUMN[k, c]
                for d in range(_COUNT[m]):
                    r, t = _ROW[m, d], _COLUMN[m, d]
                    b = W[p, r] * W[q, t]
                    if p != q and r != t:
                        b = 2.0 * (b + W[p, t] * W[q, r])
                    elif p != q or r != t:
                        b *= 2.0
                    a += _VALUE[k, c] * _VALUE[m, d] * b
            H[k, m] = a


@njit(cache=True)
def _step_by_reflections(Li, E, weight, step):
    """Return the Newton step from the root of the Hessian, half of whose digits are lost.

    With Y the columns vec(L⁻¹NₖL⁻ᵀ) and −vec(L⁻¹EL⁻ᵀ) the Hessian is YᵀY and the slope
    −Yᵀvec(I), less the weight in the last; QR of Y by Householder reflections.
    """
    Y, b = np.empty((45, 16)), np.zeros(15)
    r = 0
    for i in range(9):
        for j in range(i + 1):
            twice = 1.0 if i == j else np.sqrt(2.0)
            for k in range(14):
                a = 0.0
                for c in range(_COUNT[k]):
                    p, q = _ROW[k, c], _COLUMN[k, c]
                    d = Li[i, p] * Li[j, q]
                    if p != q:
                        d += Li[i, q] * Li[j, p]
                    a += _VALUE[k, c] * d
                Y[r, k] = twice * a
            a = 0.0
            for p in range(j + 1):
                a -= Li[i, p] * E[p] * Li[j, p]
            Y[r, 14] = twice * a
            Y[r, 15] = 1.0 if i == j else 0.0
            r += 1
    for k in range(15):
        size = 0.0
        for i in range(k, 45):
            size += Y[i, k] * Y[i, k]
        size = np.sqrt(size)
        if not size > 0.0:
            return False
        if Y[k, k] > 0.0:
            size = -size
        first = Y[k, k] - size
        for m in range(k + 1, 16):
            a = first * Y[k, m]
            for i in range(k + 1, 45):
                a += Y[i, k] * Y[i, m]
            a /= size * first
            Y[k, m] += a * first
            for i in range(k + 1, 45):
                Y[i, m] += a * Y[i, k]
        Y[k, k] = size
    b[14] = weight / Y[14, 14]
    for i in range(14, -1, -1):
        a = Y[i, 15] + b[i]
        for k in range(i + 1, 15):
            a -= Y[i, k] * step[k]
        step[i] = a / Y[i, i]
    return True


@njit(cache=True)
def feasible(X):
    """Return a t with X ⪰ t·I and room, −inf if X is too far from that."""
    L, ones = np.empty((9, 9)), np.ones(9)
    t = -0.01
    while not _definite(X, ones, t, L):
        t *= 2.5
        if t < -1e6:
            return -np.inf
    return t - 0.03 + 0.5 * t
