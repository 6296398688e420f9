"""From a minimum in floating point to a proof in rational numbers (`alignment.proofs.proof`).

Floating-point numbers are rational: Q is taken as it is. At the optimum H is singular, and no
rounding keeps a singular matrix semidefinite; |x|² = 4 on every rotation, so that lowering the
bound by 4δ and adding δ to the multipliers of the diagonal of CᵀC = I turns H into H + δI. The
smallest δ that passes the exact check is taken.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from ..status import ProvedMinimum
from .proof import UPPER, Proof, check, cost_of

#: δ relative to the scale of Q, tried in this order.
_ROOM = tuple(10.0**-k for k in range(13, 6, -1))
#: Where 11, 22 and 33 are among the multipliers.
_DIAGONAL = (0, 3, 5)
#: Quaternions are rounded to this denominator.
_UNIT = 2**40


def exact_proof(Q: ArrayLike, minimum: ProvedMinimum, label: str = "") -> Proof | None:
    """Return a proof that passes the exact check, or None if there is none.

    Parameters
    ----------
    Q : array_like, shape (10, 10)
        The matrix that was minimised.
    minimum : ProvedMinimum
    label : str
        What to call it.
    """
    Q = np.asarray(Q, dtype=float)
    entries = tuple(Fraction(float(Q[i, j])) for i, j in UPPER)
    x, y, z, w = Rotation.from_matrix(minimum.C).as_quat()
    quaternion = tuple(round(float(v) * _UNIT) for v in (w, x, y, z))
    cost = cost_of(entries, quaternion)
    found = [Fraction(float(v)) for v in minimum.multipliers(0.5 * (Q + Q.T))]
    for room in _ROOM:
        delta = Fraction(room * minimum.scale)
        shifted = [m + delta if k in _DIAGONAL else m for k, m in enumerate(found)]
        proof = Proof(label, entries, tuple(shifted), cost - 4 * delta, quaternion, cost)
        if check(proof).proved:
            return proof
    return None
