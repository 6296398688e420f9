"""Compiled least squares of a window; `alignment.in_motion.window` is its face.

The unknowns are m of velocity and sensors, x = [vec(C_ew); 1], and a clock drift at each epoch.
Nothing of it is ever a matrix with a row a measurement:

    rows of an epoch     Householder leaves eight of [−1, e, common, −z]/σ at most, whatever the
                         satellites; `common` is what all rows share, each in its own measure
    clock                a filter in square root form carries ρ·(drift) + c·[unknowns; x] from epoch
                         to epoch; one rotation an epoch takes the drift out of the rows
    all the rest         Householder folds it into one triangle, which begins as the prior

`walk[t]` is 1σ of the clock's walk from epoch t to the next [m/s]; infinite: nothing is left.
"""

from __future__ import annotations

import numpy as np

from ...filters.compiled.jit import njit

#: A row whose residual keeps less than this share of σ² has nothing that checks it.
_CHECKED = 1e-3
#: Lets the compiler use vector registers for sums.
_SUMS = {"reassoc", "contract"}


@njit(cache=True, fastmath=_SUMS)
def fold(R, M, rows):
    """Fold the rows M[column, row] into the triangle R."""
    P = R.shape[0]
    for j in range(P):
        v = M[j]
        square = 0.0
        for r in range(rows):
            square += v[r] * v[r]
        if square == 0.0:
            continue
        norm = np.sqrt(R[j, j] * R[j, j] + square)
        if R[j, j] > 0.0:
            norm = -norm
        head = R[j, j] - norm
        beta = 2.0 / (square + head * head)
        for c in range(j + 1, P):
            other = M[c]
            d = 0.0
            for r in range(rows):
                d += v[r] * other[r]
            d = (d + head * R[j, c]) * beta
            R[j, c] -= d * head
            for r in range(rows):
                other[r] -= d * v[r]
        R[j, j] = norm


@njit(cache=True)
def _reduced(a, b, keep, e, z, sigma, common, M, small):
    """small ← the triangle of the rows a … b − 1 that are kept; return how many these are."""
    k, last = np.int64(0), small.shape[0] - 1  # of 0 itself numba would make a kernel of its own
    for r in range(a, b):
        if keep[r]:
            M[0, k], M[last, k] = -1.0 / sigma[r], -z[r] / sigma[r]
            for i in range(3):
                M[1 + i, k] = e[r, i] / sigma[r]
            for i in range(last - 4):
                M[4 + i, k] = common[r, i] / sigma[r]
            k += 1
    for i in range(last + 1):
        for j in range(last + 1):
            small[i, j] = 0.0
    fold(small, M, k)
    return k


@njit(cache=True)
def without_clock(first, keep, e, z, sigma, common, at, walk, held, late, W, M, carry):
    """M[column, row] ← rows over [unknowns; x] without the clock; return how many.

    W has the columns of each epoch before the line of sight is applied. carry ← −drift at the last
    epoch as a function of [unknowns; x]. `held` is 1/σ of what nothing holds; `late`, if there is
    any, the time that goes with a clock rate, which is then the last unknown. What is `common` to
    all rows are the unknowns from `at` on, q of them. M needs up to (4 + q)n + 1 rows.
    """
    P, most = M.shape[0], 0
    for t in range(first.size - 1):
        if first[t + 1] - first[t] > most:
            most = first[t + 1] - first[t]
    q = common.shape[1]
    small, room = np.empty((5 + q, 5 + q)), np.empty((5 + q, most))
    rho, rows, alone = held, 0, 0.0
    for c in range(P):
        carry[c] = 0.0
    for t in range(first.size - 1):
        if t:
            f = 1.0 / np.sqrt(1.0 + (rho * walk[t - 1]) ** 2)
            rho = rho * f if f > 0.0 else held
            for c in range(P):
                carry[c] *= f
        if not _reduced(first[t], first[t + 1], keep, e, z, sigma, common, room, small):
            continue
        alone += small[4 + q, 4 + q] ** 2  # of z alone
        for r in range(4 + q):
            s = small[r]
            for c in range(P):
                M[c, rows] = s[1] * W[t, 0, c] + s[2] * W[t, 1, c] + s[3] * W[t, 2, c]
            for i in range(q):
                M[at + i, rows] += s[4 + i]
            M[P - 1, rows] += s[4 + q]
            if r == 0:
                if late.size:
                    M[P - 11, rows] += s[0] * late[t]
                norm = np.sqrt(rho * rho + s[0] * s[0])
                a, b = rho / norm, s[0] / norm
                for c in range(P):
                    y, x = M[c, rows], carry[c]
                    M[c, rows], carry[c] = a * y - b * x, b * y + a * x
                rho = norm
            rows += 1
    for c in range(P):
        M[c, rows] = 0.0
        carry[c] /= rho
    M[P - 1, rows] = np.sqrt(alone)
    return rows + 1


@njit(cache=True)
def forward_substitute(R, Y):
    """Y[k] ← R⁻ᵀ Y[k] for each row of Y."""
    m = Y.shape[1]
    for k in range(Y.shape[0]):
        y = Y[k]
        for i in range(m):
            y[i] /= R[i, i]
            x = y[i]
            for j in range(i + 1, m):
                y[j] -= R[i, j] * x


@njit(cache=True)
def _smooth(diagonal, coupling, S, variance):
    """S ← T⁻¹S and variance ← the diagonal of T⁻¹, T tridiagonal."""
    n = diagonal.size
    L = np.empty(n)
    for t in range(1, n):
        L[t] = coupling[t - 1] / diagonal[t - 1]
        diagonal[t] -= L[t] * coupling[t - 1]
        for c in range(S.shape[1]):
            S[t, c] -= L[t] * S[t - 1, c]
    for t in range(n - 1, -1, -1):
        variance[t] = 1.0 / diagonal[t]
        for c in range(S.shape[1]):
            S[t, c] /= diagonal[t]
            if t < n - 1:
                S[t, c] -= L[t + 1] * S[t + 1, c]
        if t < n - 1:
            variance[t] += L[t + 1] ** 2 * variance[t + 1]


@njit(cache=True)
def scores(
    first, keep, e, z, sigma, common, at, walk, held, V, flat, own, clock, joint, score
):  # fmt: skip
    """score ← |residual| in 1σ of it after the fit of the rows kept, zero where nothing checks one.

    V has the columns of each epoch before the line of sight is applied: those of `joint`, the
    triangle over [unknowns; θ], and the value; `flat` what comes to them for all satellites alike,
    `own` what comes to the value of each row by what is `common`, the unknowns from `at` on.
    `clock` is the value that the drifts were found with.
    """
    n, p, q = V.shape[0], V.shape[2] - 1, common.shape[1]
    S, fitted, row = np.zeros((n, p + 1)), np.zeros((4 + q, p)), np.zeros(p)
    diagonal, coupling, variance = np.zeros(n), np.zeros(n), np.zeros(n)
    for t in range(n):
        for r in range(first[t], first[t + 1]):
            if keep[r]:
                w = 1.0 / sigma[r] ** 2
                diagonal[t] += w
                S[t, p] += w * (clock[r] - z[r])
                for c in range(p):
                    value = flat[t, c]
                    for i in range(3):
                        value += e[r, i] * V[t, i, c]
                    S[t, c] += w * value
                for i in range(q):
                    S[t, at + i] += w * common[r, i]
        if t == 0 or walk[t - 1] == np.inf:
            diagonal[t] += held * held
    for t in range(n - 1):
        if walk[t] < np.inf:
            w = 1.0 / walk[t] ** 2
            diagonal[t] += w
            diagonal[t + 1] += w
            coupling[t] = -w
    _smooth(diagonal, coupling, S, variance)
    for t in range(n):
        for c in range(p):
            for i in range(3):
                fitted[i, c] = V[t, i, c]
            fitted[3, c] = flat[t, c] - S[t, c]
            for i in range(q):
                fitted[4 + i, c] = 1.0 if c == at + i else 0.0
        forward_substitute(joint, fitted)
        for r in range(first[t], first[t + 1]):
            residual, leverage = flat[t, p] - S[t, p] + own[r] - z[r], 0.0
            for i in range(3):
                residual += e[r, i] * V[t, i, p]
            for c in range(p):
                row[c] = fitted[3, c]
                for i in range(3):
                    row[c] += e[r, i] * fitted[i, c]
                for i in range(q):
                    row[c] += common[r, i] * fitted[4 + i, c]
                leverage += row[c] * row[c]
            left = 1.0 - (variance[t] + leverage) / sigma[r] ** 2
            score[r] = 0.0
            if keep[r] and left > _CHECKED:
                score[r] = abs(residual) / (sigma[r] * np.sqrt(left))
