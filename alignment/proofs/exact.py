"""From a minimum in floating point to a proof in rational numbers (`alignment.proofs.proof`).

Floating-point numbers are rational: Q is taken as it is. Rotation and multipliers are moved until
Hx = 0 to far more digits than theirs (`alignment.solver.exact_cost`). At the optimum H is singular,
and no rounding keeps a singular matrix semidefinite; |x|² = 4 on every rotation, so that lowering
the bound by 4δ and adding δ to the multipliers of the diagonal of CᵀC = I turns H into H + δI. The
smallest δ that passes the exact check is taken.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike

from ..priors import Prior
from ..problem import ClockModel
from ..rows import AlignmentRows
from ..solver.exact_cost import ExactCost, integer_quaternion, multipliers_at
from ..status import ProvedMinimum
from .evidence import Evidence
from .proof import GAP, UPPER, Proof, check, cost_of

#: δ relative to the scale of Q, tried in this order.
_ROOM = tuple(10.0**-k for k in range(21, 6, -1))
#: Bounds are rounded down to a multiple of one over this.
_FINE = 1 << 200
#: Where 11, 22 and 33 are among the multipliers.
_DIAGONAL = (0, 3, 5)


def exact_proof(
    Q: ArrayLike, minimum: ProvedMinimum, label: str = "", evidence: Evidence | None = None
) -> Proof | None:
    """Return a proof that passes the exact check, or None if there is none.

    Parameters
    ----------
    Q : array_like, shape (10, 10)
        The matrix that was minimised, in χ² units.
    minimum : ProvedMinimum
    label : str
        What to call it.
    evidence : Evidence, optional
        The rows that Q was made from.
    """
    Q = np.asarray(Q, dtype=float)
    exact = ExactCost.of(Q)
    entries = tuple(Fraction(int(exact.entries[i, j]), 1 << exact.exponent) for i, j in UPPER)
    C, found = minimum.C, minimum.multipliers(0.5 * (Q + Q.T))
    q = exact.refined(integer_quaternion(C))
    quaternion = tuple(int(v) for v in q)
    cost = cost_of(entries, quaternion)
    moved = multipliers_at(exact, q, found)
    proof = Proof(label, entries, moved, cost, quaternion, cost)
    for room in _ROOM:
        delta = Fraction(room * minimum.scale)
        if 4 * delta > GAP:
            break
        shifted = tuple(m + delta if k in _DIAGONAL else m for k, m in enumerate(moved))
        bound = Fraction(int((cost - 4 * delta) * _FINE // 1), _FINE)
        proof = replace(proof, multipliers=shifted, bound=bound)
        if check(proof).proved:
            return replace(proof, evidence=evidence)
    return None


def evidence_of(
    rows: AlignmentRows, clock: ClockModel, priors: Iterable[Prior], correlated: float = 1.0
) -> Evidence:
    """Return the rows that `alignment.problem.build_problem` makes a cost of, with their σ."""
    rows = rows.correlated(correlated)
    table = np.column_stack([rows.e_e, rows.vel_w, rows.z, rows.sigma, rows.time, rows.shared])
    return Evidence(
        tuple(tuple(row) for row in table.tolist()), tuple(rows.epoch.tolist()),
        clock.kind, float(clock.q or 0.0),
        tuple(tuple(row) for prior in priors for row in np.asarray(prior.rows).tolist()),
    )  # fmt: skip
