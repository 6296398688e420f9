"""The rotation group as quadratic equations: xᵀAx = 0 for x = [vec(C); 1], C in SO(3).

vec stacks columns. Three families (Song et al., section IV; Briales and Gonzalez-Jimenez 2017):

- columns, CᵀC = I: the orthonormality that defines the problem together with det C = +1,
- rows, CCᵀ = I: implied by the columns, but not by their relaxation,
- handedness, cᵢ × cⱼ = cₖ cyclically: the quadratic form of det C = +1.

The last two are redundant on SO(3) and decisive for the relaxation: it is not tight without
handedness when the motion is planar. All three together span every quadratic form that vanishes
on SO(3) (20 of the 55 dimensions).
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import ArrayLike

from ...filters.errors import ConfigError
from ...filters.rotation import FloatArray

#: Every family, in the order of the stacked matrices.
ALL = ("columns", "rows", "handedness")

#: The form that is 1 on every lifted rotation: J = e₁₀e₁₀ᵀ.
HOMOGENEOUS: FloatArray = np.diag([0.0] * 9 + [1.0])


def lift(C: ArrayLike) -> FloatArray:
    """Return x = [vec(C); 1], columns stacked, shape (..., 10) for C of shape (..., 3, 3)."""
    C = np.asarray(C, dtype=float)
    if C.ndim == 2:
        x = np.ones(10)
        x[:9] = C.T.reshape(9)
        return x
    r = np.swapaxes(C, -1, -2).reshape(*C.shape[:-2], 9)
    return np.concatenate([r, np.ones((*r.shape[:-1], 1))], axis=-1)


def unlift(x: ArrayLike) -> FloatArray:
    """Return the 3×3 matrix of x = [vec(C); h] with its homogeneous entry divided out."""
    x = np.asarray(x, dtype=float)
    return np.swapaxes((x[..., :9] / x[..., 9:]).reshape(*x.shape[:-1], 3, 3), -1, -2)


def _index(row: int, column: int) -> int:
    return 3 * column + row


def _orthonormality(index) -> FloatArray:
    """Return the six forms Σᵢ C[i,a]·C[i,b] − δ_ab, with `index` telling where C[i,a] is."""
    forms = []
    for a in range(3):
        for b in range(a, 3):
            A = np.zeros((10, 10))
            for i in range(3):
                A[index(i, a), index(i, b)] += 0.5
                A[index(i, b), index(i, a)] += 0.5
            A[9, 9] = -float(a == b)
            forms.append(A)
    return np.array(forms)


def _handedness() -> FloatArray:
    """Return the nine forms (cᵢ × cⱼ − cₖ)·e_a for cyclic (i, j, k)."""
    forms = []
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        for a in range(3):
            p, q = (a + 1) % 3, (a + 2) % 3
            A = np.zeros((10, 10))
            A[_index(p, i), _index(q, j)] += 1.0
            A[_index(q, i), _index(p, j)] -= 1.0
            A[_index(a, k), 9] -= 1.0
            forms.append(0.5 * (A + A.T))
    return np.array(forms)


#: CᵀC = I, six forms ordered 11, 12, 13, 22, 23, 33.
COLUMNS: FloatArray = _orthonormality(_index)
#: CCᵀ = I, six forms in the same order; their trace is that of `COLUMNS`.
ROWS: FloatArray = _orthonormality(lambda i, a: _index(a, i))
#: c₁×c₂ = c₃, c₂×c₃ = c₁, c₃×c₁ = c₂, three components each.
HANDEDNESS: FloatArray = _handedness()


def constraint_matrices(families: Collection[str] = ALL) -> FloatArray:
    """Return the linearly independent forms of the given families, shape (m, 10, 10).

    Parameters
    ----------
    families : collection of {'columns', 'rows', 'handedness'}
        'columns' or 'rows' must be there. Both together count eleven, not twelve: the traces of
        CᵀC and CCᵀ are one form, and its double would leave the multipliers undetermined.

    Raises
    ------
    ConfigError
        For an unknown family, or if nothing makes the matrix orthonormal.
    """
    for family in families:
        if family not in ALL:
            raise ConfigError.unknown_key(family, ALL, "constraints")
    if not {"columns", "rows"} & set(families):
        raise ConfigError(
            "constraints: expected 'columns' or 'rows', without them C is no rotation"
        )
    parts = []
    if "columns" in families:
        parts.append(COLUMNS)
    if "rows" in families:
        parts.append(ROWS[:-1] if "columns" in families else ROWS)
    if "handedness" in families:
        parts.append(HANDEDNESS)
    return np.concatenate(parts)


def lagrangian(
    Q: ArrayLike, dual_cost: float, multipliers: ArrayLike, families: Collection[str] = ALL
) -> FloatArray:
    """Return H = Q − γJ + Σ λₖAₖ, shape (10, 10)."""
    weighted = np.tensordot(np.asarray(multipliers), constraint_matrices(families), axes=1)
    return np.asarray(Q, dtype=float) - dual_cost * HOMOGENEOUS + weighted


def multipliers_between(Q: ArrayLike, H: ArrayLike) -> FloatArray:
    """Return the λ of all twenty forms with `lagrangian` equal to H for some γ."""
    difference = np.asarray(H, dtype=float) - np.asarray(Q, dtype=float)
    forms = np.concatenate([constraint_matrices(ALL), [HOMOGENEOUS]]).reshape(-1, 100)
    return np.linalg.lstsq(forms.T, difference.ravel(), rcond=None)[0][:-1]
