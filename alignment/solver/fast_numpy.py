"""The fast solver without a compiler: the same steps as `alignment.solver.fast_compiled`, in numpy.

A numpy call costs a microsecond or ten whatever it computes, so the starts of one round descend
together, and the barrier multiplies all fourteen null matrices at once.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from ...filters.rotation import FloatArray, orthonormalise
from .quartic import GRID, GRID_FEATURES, GRID_NEAR, NULL_GRAMS, gram, lower_triangle, reduced_gram

#: Distinct starts tried before the barrier is asked, and in all.
FIRST_STARTS, ALL_STARTS = 3, 24
#: t that counts as closed without uniqueness.
GAP = 1e-9
#: As in `alignment.solver.margin_kernels`.
MARGINS = (1e-2, 1e-4, 1e-6, 1e-8)
ENOUGH = MARGINS[-1]
BARRIER_STEPS, TRUST_STEPS = 80, 150
#: Ratio of curvatures from which a basin is a valley, and curvature that rounding may have made.
STIFF, FLAT = 1e-2, 5e-13
#: Cost difference below which a later start is no improvement.
SAME_COST = 1e-13

_NULL_ROWS = NULL_GRAMS.reshape(14, 81)
_NULL_COLUMNS = np.ascontiguousarray(_NULL_ROWS.T)
_UNIT = np.eye(9).ravel()


def solve(Q: FloatArray) -> tuple[FloatArray, float, float, FloatArray, FloatArray, int, int, int]:
    """Minimise xᵀQx, scale 1, over the rotations.

    Returns
    -------
    C, cost, t, X, slope, starts, Newton steps, barrier steps
        The Gram matrix X and ∂f/∂θ/√2 are those of C; t is the margin that X proves.
    """
    left = GRID_FEATURES @ lower_triangle(Q)
    best, t, starts, newtons, barriers = np.inf, -np.inf, 0, 0, 0
    C, X, slope, fresh = GRID[0], np.zeros((9, 9)), np.zeros(3), False
    for end in (1, FIRST_STARTS, ALL_STARTS):
        first = _next_starts(left, end - starts)
        if first:
            starts += len(first)
            found, grams, steps = _newton(Q, GRID[first])
            newtons += steps
            k = int(np.argmin(grams[:, 0, 0]))
            if grams[k, 0, 0] < best - SAME_COST:
                best, C, fresh = float(grams[k, 0, 0]), found[k], True
                X, slope = smallest_gram(grams[k])
                t = quick_margin(X)
                if t > 0.0:
                    break
        if fresh and end > 1:
            t, X, steps = largest_margin(X, ENOUGH, -2.0 * GAP)
            barriers += steps
            fresh = False
            if t > -GAP:
                break
    return C, best, t, X, slope, starts, newtons, barriers


def minima(Q: FloatArray, starts: int) -> tuple[FloatArray, FloatArray]:
    """Return the distinct minima reached from `starts` grid rotations, and their costs."""
    found, grams, _ = _newton(Q, GRID[_next_starts(GRID_FEATURES @ lower_triangle(Q), starts)])
    order = np.argsort(grams[:, 0, 0], kind="stable")
    kept: list[int] = []
    for k in order:
        if all(np.sum(found[k] * found[m]) <= 2.9999 for m in kept):
            kept.append(int(k))
    return found[kept], grams[kept, 0, 0]


def descend(Q: FloatArray, C: FloatArray) -> tuple[FloatArray, int]:
    """Return the bottom of the basin that C lies in, and the Newton steps to it.

    A trust region, which takes more steps than `_newton`. Before a step is judged it is brought
    back to the floor of the valley, across it: valleys a hundred thousand times longer than wide
    are walked along in strides that do not depend on their width.
    """
    G, radius, before = gram(Q, C), 0.5, np.inf
    steps = 0
    while steps < TRUST_STEPS:
        steps += 1
        H0, slope = reduced_gram(G)
        values, axes = np.linalg.eigh(H0[:3, :3])
        along = axes.T @ slope
        theta = -axes @ (along / (values + _damping(values, along, radius)))
        expected = -float(slope @ theta + 0.5 * theta @ H0[:3, :3] @ theta)
        if expected <= 1e-14:
            # Costs no longer tell: Newton steps for as long as they shrink, where it is not flat.
            theta = -axes @ np.where(values > FLAT, along / np.maximum(values, FLAT), 0.0)
        length = float(np.sqrt(theta @ theta))
        trial = C @ _cayley(theta[None])[0]
        if expected > 1e-14 and values[0] < STIFF * values[2]:
            trial = _across(Q, trial)
        after = gram(Q, trial)
        if expected <= 1e-14:
            if not length < min(0.5 * before, 0.5):
                break
            before = length
        elif G[0, 0] - after[0, 0] < 0.1 * expected:
            radius = 0.3 * min(radius, length)
            continue
        elif G[0, 0] - after[0, 0] > 0.7 * expected:
            radius = min(max(radius, 2.5 * length), 0.7)
        C, G = trial, after
    return orthonormalise(C), steps


def _across(Q: FloatArray, C: FloatArray) -> FloatArray:
    """Return C after three Newton steps in the directions in which the cost is stiff."""
    for _ in range(3):
        H0, slope = reduced_gram(gram(Q, C))
        values, axes = np.linalg.eigh(H0[:3, :3])
        stiff = values > max(abs(values[0]) / STIFF, STIFF * values[2])
        theta = -axes @ np.where(stiff, axes.T @ slope / np.maximum(values, 1e-300), 0.0)
        C = C @ _cayley(theta[None] * min(1.0, 0.5 / max(float(np.sqrt(theta @ theta)), 0.5)))[0]
    return C


def _damping(values: FloatArray, along: FloatArray, radius: float) -> float:
    """Return the least shift with which the Newton step is a descent no longer than `radius`."""

    def too_long(shift: float) -> bool:
        return bool(np.sum((along / (values + shift)) ** 2) > radius * radius)

    if values[0] > 0.0 and not too_long(0.0):
        return 0.0
    low = max(-float(values[0]), 0.0) + 1e-16
    if not too_long(low):
        return low
    high = low + float(np.sqrt(along @ along)) / radius
    for _ in range(60):
        middle = np.sqrt(low * high) if low > 1e-3 * high else 0.03 * high
        low, high = (middle, high) if too_long(middle) else (low, middle)
        if high < 1.1 * low:
            break
    return high


def own_bottom(Q: FloatArray, C: FloatArray) -> list[FloatArray]:
    """Return where the descent from C ends."""
    return [descend(Q, C)[0]]


def low_bottoms(Q: FloatArray, C: FloatArray) -> list[FloatArray]:
    """Return where the descents from C and from the lowest few of all minima end."""
    return [descend(Q, start)[0] for start in (C, *minima(Q, ALL_STARTS)[0][:FIRST_STARTS])]


def _next_starts(costs: FloatArray, number: int) -> list[int]:
    """Return the cheapest grid rotations left, mutually apart, and strike off their neighbours."""
    chosen: list[int] = []
    while len(chosen) < number:
        best = int(np.argmin(costs))
        if not np.isfinite(costs[best]):
            break
        chosen.append(best)
        costs[GRID_NEAR[best]] = np.inf
    return chosen


def _newton(Q: FloatArray, start: FloatArray) -> tuple[FloatArray, FloatArray, int]:
    """Descend from several rotations together; return them, their Gram matrices and the steps."""
    C, G = start.copy(), gram(Q, start)
    going = np.arange(len(C))
    total = 0
    for _ in range(40):
        H0, slope = reduced_gram(G[going])
        values, axes = np.linalg.eigh(H0[:, :3, :3])
        scale = np.abs(values).sum(axis=1, keepdims=True)
        along = (slope[:, None, :] @ axes)[:, 0]
        # Eigenvalues made positive: a Newton step that always descends.
        theta = -(axes @ (along / np.maximum(np.abs(values), 1e-12 * scale))[..., None])[..., 0]
        length = np.sqrt(np.sum(theta * theta, axis=1))
        theta *= np.minimum(1.0, 0.7 / np.maximum(length, 1e-300))[:, None]
        before, size = G[going, 0, 0], np.ones(len(going))
        for _ in range(12):
            turned = C[going] @ _cayley(theta * size[:, None])
            after = gram(Q, turned)
            worse = after[:, 0, 0] > before + 1e-15
            if not worse.any():
                break
            size[worse] *= 0.5
        better = after[:, 0, 0] <= before + 1e-15
        C[going[better]], G[going[better]] = turned[better], after[better]
        total += len(going)
        # Quadratic convergence: the step after one this small is rounding.
        going = going[better & (length > 1e-8)]
        if not len(going):
            break
    C = orthonormalise(C)
    return C, gram(Q, C), total


def _cayley(theta: FloatArray) -> FloatArray:
    """Return the rotations of the quaternions (1, θ/2)/|…|."""
    u = 0.5 * theta
    K = np.zeros((len(u), 3, 3))
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -u[:, 2], u[:, 1], -u[:, 0]
    K[:, 1, 0], K[:, 2, 0], K[:, 2, 1] = u[:, 2], -u[:, 1], u[:, 0]
    return np.eye(3) + (2.0 / (1.0 + np.sum(u * u, axis=1)))[:, None, None] * (K + K @ K)


def smallest_gram(G: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the Gram matrix of f − f(C) nearest to zero and ∂f/∂θ/√2."""
    H0, slope = reduced_gram(G)
    return H0 - (_NULL_COLUMNS @ (_NULL_ROWS @ H0.ravel())).reshape(9, 9), slope / np.sqrt(2.0)


def quick_margin(X: FloatArray) -> float:
    """Return the largest of MARGINS below the smallest eigenvalue of X, or −inf."""
    smallest = np.linalg.eigvalsh(X)[0]
    return next((t for t in MARGINS if t < smallest), -np.inf)


def largest_margin(X: FloatArray, enough: float, hopeless: float) -> tuple[float, FloatArray, int]:
    """Maximise t with X + Σ μₖNₖ ⪰ t·I; return t, the matrix and the barrier steps."""
    t = min(float(np.linalg.eigvalsh(X)[0]), 0.0)
    return barrier(X, np.ones(9), 1.5 * t - 0.04, enough, hopeless, 1e-13)


def barrier(
    X: FloatArray, E: FloatArray, s: float, enough: float, hopeless: float, gap: float
) -> tuple[float, FloatArray, int]:
    """Maximise s subject to X + Σ μₖNₖ ⪰ s·diag(E); return s, the matrix and the steps."""
    weight = 0.0
    Y = np.empty((81, 15))
    root = _root(X, s, E)
    if root is None:
        return -np.inf, X, 0
    for steps in range(1, BARRIER_STEPS + 1):
        half = np.linalg.inv(root)
        # The Hessian is YᵀY and the slope −Yᵀvec(I), less the weight: its root keeps the digits.
        Y[:, :14] = (half @ NULL_GRAMS @ half.T).reshape(14, 81).T
        Y[:, 14] = -((half * E) @ half.T).ravel()
        weight = weight or -float(Y[:, 14] @ _UNIT)
        Q, R = np.linalg.qr(Y)
        if not np.all(np.diag(R)):
            return s, X, steps
        toward = Q.T @ _UNIT
        toward[14] += weight / R[14, 14]
        step = solve_triangular(R, toward, check_finite=False)
        decrement = float(step @ (Y.T @ _UNIT)) + weight * float(step[14])
        D = (_NULL_COLUMNS @ step[:14]).reshape(9, 9)
        value = -weight * s - 2.0 * float(np.log(np.diag(root)).sum())
        length = 1.0
        for _ in range(60):
            trial_s = s + length * float(step[14])
            trial = _root(X + length * D, trial_s, E)
            if trial is not None:
                reached = -weight * trial_s - 2.0 * float(np.log(np.diag(trial)).sum())
                if reached <= value - 0.1 * length * decrement + 1e-9 * abs(value):
                    break
            length *= 0.6
        else:
            return s, X, steps
        assert trial is not None
        X, s, root = X + length * D, trial_s, trial
        if s >= enough:
            return s, X, steps
        if length == 1.0 and decrement < 1.0:
            if 9.0 / weight < gap or s + 20.0 / weight < hopeless:
                return s, X, steps
            weight *= 60.0
    return s, X, BARRIER_STEPS


def _root(X: FloatArray, s: float, E: FloatArray) -> FloatArray | None:
    try:
        return np.asarray(np.linalg.cholesky(X - s * np.diag(E)), dtype=float)
    except np.linalg.LinAlgError:
        return None
