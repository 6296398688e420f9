"""The cost as a quartic form of the unit quaternion, which is what makes a solver fast.

With q = (w, u), |q| = 1, and the ten quadratic monomials

    m = (w², √2 w u₁, √2 w u₂, √2 w u₃, u₁², u₂², u₃², √2 u₁u₂, √2 u₁u₃, √2 u₂u₃),   |m| = |q|²,

x = [vec(R(q)); 1] = Z m with Z/2 orthogonal. The relaxation with all constraints is therefore the
sum-of-squares relaxation of a quartic in four variables (Parrilo 2003): f − γ is to be written as
mᵀGm with G ⪰ 0, and G is free up to the 20 symmetric matrices with mᵀNm = 0.

Turn the axes so that the candidate C is the identity, C·R(q). There f − f(C) and its gradient
vanish, hence the row of w² in G must vanish too, and 6 of the 20 freedoms are used up in moving
w²·u_iu_j to (w u_i)(w u_j). What is left is a 9×9 matrix on (w u, u u),

    [ B   C ]
    [ Cᵀ  D ] + Σ μₖNₖ ⪰ t·I,       B the Riemannian Hessian, Nₖ fourteen constant matrices,

and with it f(C·R(q)) − f(C) ≥ t (1 − w⁴): a lower bound if t ≥ 0, uniqueness if t > 0.
"""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from ...filters.rotation import FloatArray, skew
from .constraints import lift

_SQRT2 = np.sqrt(2.0)

#: The monomials of m as pairs of indices into q = (w, u₁, u₂, u₃).
MONOMIALS = ((0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (2, 2), (3, 3), (1, 2), (1, 3), (2, 3))
_WEIGHT = np.array([1.0 if a == b else _SQRT2 for a, b in MONOMIALS])

#: s·m = |q|².
NORM: FloatArray = np.array([1.0, 0, 0, 0, 1, 1, 1, 0, 0, 0])


def monomials(q: ArrayLike) -> FloatArray:
    """Return m of quaternions (w, u), scalar first, shape (..., 10) for (..., 4)."""
    q = np.asarray(q, dtype=float)
    return np.stack([q[..., a] * q[..., b] for a, b in MONOMIALS], axis=-1) * _WEIGHT


def _rotation_forms() -> FloatArray:
    """Return Z, column by column from the polarised |q|²·R(q)."""

    def lifted(q: FloatArray) -> FloatArray:
        w, u = q[0], q[1:]
        matrix = (w * w - u @ u) * np.eye(3) + 2.0 * (np.outer(u, u) + w * skew(u))
        return np.append(lift(matrix)[:9], q @ q)

    unit = np.eye(4)
    return np.stack(
        [
            lifted(unit[a])
            if a == b
            else (lifted(unit[a] + unit[b]) - lifted(unit[a]) - lifted(unit[b])) / _SQRT2
            for a, b in MONOMIALS
        ],
        axis=1,
    )


#: x = Z m, ZᵀZ = 4I.
Z: FloatArray = _rotation_forms()


def _null_grams() -> FloatArray:
    """Return the fourteen Nₖ, Frobenius-orthonormal: one product, several pairs of monomials."""
    same: dict[tuple[int, ...], list[tuple[int, int]]] = {}
    for p, q in combinations_with_replacement(range(9), 2):
        product = tuple(sorted(MONOMIALS[p + 1] + MONOMIALS[q + 1]))
        same.setdefault(product, []).append((p, q))
    grams = []
    for pairs in same.values():
        # What a symmetric matrix of unit norm at (p, q) and (q, p) adds to the coefficient.
        unit = [np.where(p == q, 1.0, 1.0 / _SQRT2) for p, q in pairs]
        share = [
            (1.0 if p == q else 2.0) * u * _WEIGHT[p + 1] * _WEIGHT[q + 1]
            for (p, q), u in zip(pairs, unit, strict=True)
        ]
        for row in np.linalg.svd(np.array([share]))[2][1:]:
            N = np.zeros((9, 9))
            for (p, q), u, value in zip(pairs, unit, row, strict=True):
                N[p, q] = N[q, p] = u * value
            grams.append(N)
    return np.array(grams)


#: Symmetric 9×9 matrices with mᵀNm = 0 on (w u, u u), shape (14, 9, 9), orthonormal.
NULL_GRAMS: FloatArray = _null_grams()


def gram(Q: ArrayLike, C: ArrayLike) -> FloatArray:
    """Return G with f(C·R(q)) |q|⁴ = mᵀGm, shape (..., 10, 10) for C of shape (..., 3, 3)."""
    C = np.asarray(C, dtype=float)
    turned = np.empty((*C.shape[:-2], 10, 10))
    turned[..., :9, :] = (C[..., None, :, :] @ Z[:9].reshape(3, 3, 10)).reshape(
        *C.shape[:-2], 9, 10
    )
    turned[..., 9, :] = Z[9]
    return np.swapaxes(turned, -1, -2) @ np.asarray(Q, dtype=float) @ turned


def reduced_gram(G: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the 9×9 matrix of f − f(C), and what remains of the row of w².

    Parameters
    ----------
    G : array_like, shape (..., 10, 10)
        Of `gram`.

    Returns
    -------
    H0 : ndarray, shape (..., 9, 9)
        Its leading 3×3 block is the Riemannian Hessian ∂²f/∂θ² of C·Exp(θ).
    slope : ndarray, shape (..., 3)
        ∂f/∂θ, zero at a stationary point.
    """
    G = np.asarray(G, dtype=float)
    centred = G - G[..., :1, :1] * np.outer(NORM, NORM)
    row, H0 = centred[..., 0, :], centred[..., 1:, 1:].copy()
    for i in range(3):
        H0[..., i, i] += row[..., 4 + i]
    for k, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
        H0[..., i, j] += row[..., 7 + k] / _SQRT2
        H0[..., j, i] += row[..., 7 + k] / _SQRT2
    return H0, _SQRT2 * row[..., 1:4]


def lagrangian_of(X: ArrayLike, C: ArrayLike) -> FloatArray:
    """Return H = Q − f(C)J + Σ λₖAₖ of a 9×9 Gram matrix, in the axes of Q, shape (10, 10)."""
    block = np.zeros((10, 10))
    block[1:, 1:] = X
    T = np.eye(10)
    T[:9, :9] = np.kron(np.eye(3), np.asarray(C, dtype=float))
    # m = Zᵀx/4.
    return T @ Z @ block @ Z.T @ T.T / 16.0


def super_fibonacci(n: int) -> FloatArray:
    """Return n rotations spread evenly over SO(3) (Alexa, CVPR 2022), shape (n, 3, 3)."""
    s = np.arange(n) + 0.5
    inner, outer = np.sqrt(s / n), np.sqrt(1.0 - s / n)
    alpha = 2.0 * np.pi * s / _SQRT2
    beta = 2.0 * np.pi * s / 1.533751168755204288118041
    q = np.stack(
        [inner * np.sin(alpha), inner * np.cos(alpha), outer * np.sin(beta), outer * np.cos(beta)],
        axis=-1,
    )
    return Rotation.from_quat(q).as_matrix()


#: Rotations the solvers start from; none is further than 61° from one of them.
GRID: FloatArray = super_fibonacci(64)
_PAIR_ROW, _PAIR_COLUMN = np.tril_indices(10)
_GRID_X: FloatArray = lift(GRID)
#: Cost of the grid's rotations = GRID_FEATURES @ (lower triangle of Q, row by row).
GRID_FEATURES: FloatArray = np.ascontiguousarray(
    _GRID_X[:, _PAIR_ROW] * _GRID_X[:, _PAIR_COLUMN] * np.where(_PAIR_ROW == _PAIR_COLUMN, 1.0, 2.0)
)
#: Which of them lie within 60° of each other: one basin, one start.
GRID_NEAR = np.ascontiguousarray(_GRID_X[:, :9] @ _GRID_X[:, :9].T > 2.0)


def lower_triangle(Q: FloatArray) -> FloatArray:
    """Return the 55 entries that `GRID_FEATURES` multiplies."""
    return Q[_PAIR_ROW, _PAIR_COLUMN]
