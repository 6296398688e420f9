"""An exact check of an alignment proof, in integers and fractions, by itself.

Nothing here is shared with what finds the rotation: no floating point, no numpy, no solver. A
proof is a cost matrix Q, twenty multipliers λ and a bound γ, all rational, an integer quaternion,
and in a file the rows that Q was made from. What is checked:

    H = Q − γJ + Σ λₖAₖ is positive definite       (leading minors, fraction-free elimination)
    xᵀAₖx = 0 for every rotation, x = [vec(C); 1]   (the forms below, by construction)

hence f(C) = xᵀQx ≥ γ **for every rotation C and this Q**. The cost of the quaternion's rotation is
recomputed exactly and says how far above γ the best may lie at most, in χ²: Q has the noise of the
rows in it, and no constant added to Q changes what a unit of it means. Where rows are there, their
own Q is computed from them (`alignment.proofs.evidence`), and how far it is from the one at hand,
|ΔQ| in the Frobenius norm, times |x|² = 4, is added on both sides. That is all: nothing is said
about the uniqueness of the optimum, or about the vehicle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import isqrt, lcm
from typing import Any

from .evidence import Evidence, cost_matrix

#: Order of Q's entries: upper triangle, row by row.
UPPER = tuple((i, j) for i in range(10) for j in range(i, 10))
#: Gap [χ²] above which a rotation is not called optimal, `alignment.status.GAP`.
GAP = Fraction(1, 100)
#: Bits behind the point of a root that is rounded up.
_ROOT = 128

Matrix = list[list[Fraction]]


@dataclass(frozen=True)
class Proof:
    """What a proof file says of one window.

    Attributes
    ----------
    label : str
        Which window; not part of the proof.
    Q : tuple of Fraction
        Upper triangle, row by row, 55 entries.
    multipliers : tuple of Fraction
        One for each of `forms`.
    bound : Fraction
        γ: no rotation costs less.
    quaternion : tuple of int
        (w, x, y, z) of the rotation, of any length.
    cost : Fraction
        What it is said to cost.
    evidence : Evidence, optional
        The rows that Q was made from.
    window : int
        Which of the recording's windows it is, from 0.
    """

    label: str
    Q: tuple[Fraction, ...]
    multipliers: tuple[Fraction, ...]
    bound: Fraction
    quaternion: tuple[int, ...]
    cost: Fraction
    evidence: Evidence | None = None
    window: int = 0

    def __repr__(self) -> str:
        bound, cost = float(self.bound), float(self.cost)
        return f"<Proof '{self.label}': no rotation below {bound:.9g}, this one at {cost:.9g}>"

    def as_dict(self) -> dict[str, Any]:
        """Return it as it is written: fractions as text."""
        rows = {} if self.evidence is None else {"evidence": self.evidence.as_dict()}
        return {
            "label": self.label,
            "window": self.window,
            "Q": [str(q) for q in self.Q],
            "multipliers": [str(m) for m in self.multipliers],
            "bound": str(self.bound),
            "quaternion": list(self.quaternion),
            "cost": str(self.cost),
            **rows,
        }


@dataclass(frozen=True)
class Checked:
    """What follows from a proof.

    Attributes
    ----------
    proved : bool
    bound, cost : Fraction
        Every rotation costs `bound` or more; the one at hand costs `cost`, exactly.
    gap : Fraction
        cost − bound [χ²], and what the rows may make of it.
    reason : str
        One line: the statement proved, or why nothing is.
    """

    proved: bool
    bound: Fraction
    cost: Fraction
    gap: Fraction
    reason: str


def forms() -> list[dict[tuple[int, int], Fraction]]:
    """Return twenty quadratic forms that vanish on [vec(C); 1], as entries of symmetric matrices.

    Columns stacked: C[i][j] is x[3j + i]. CᵀC = I in the order 11, 12, 13, 22, 23, 33; CCᵀ = I
    without the last; cᵢ × cⱼ = cₖ, cyclic, component by component.
    """
    found = []
    for by_rows in (False, True):
        for a in range(3):
            for b in range(a, 3):
                pairs = [(_at(a, i), _at(b, i)) if by_rows else (_at(i, a), _at(i, b))
                         for i in range(3)]  # fmt: skip
                found.append(_form([(p, q, 1) for p, q in pairs], -int(a == b)))
    found.pop()  # the traces of both are one form
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        for a in range(3):
            p, q = (a + 1) % 3, (a + 2) % 3
            terms = [(_at(p, i), _at(q, j), 1), (_at(q, i), _at(p, j), -1), (_at(a, k), 9, -1)]
            found.append(_form(terms, 0))
    return found


def _at(row: int, column: int) -> int:
    return 3 * column + row


def _form(terms: list[tuple[int, int, int]], constant: int) -> dict[tuple[int, int], Fraction]:
    """Return the symmetric matrix of Σ s·x_p·x_q + constant·x₉²."""
    entries: dict[tuple[int, int], Fraction] = {}
    for p, q, sign in [*terms, (9, 9, constant)]:
        for place in ((p, q), (q, p)):
            entries[place] = entries.get(place, Fraction(0)) + Fraction(sign, 2)
    return {place: value for place, value in entries.items() if value}


def rotation(quaternion: tuple[int, ...]) -> Matrix:
    """Return the exact rotation of an integer quaternion (w, x, y, z) of any length."""
    w, x, y, z = quaternion
    n = w * w + x * x + y * y + z * z
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return [[Fraction(entry, n) for entry in row] for row in rows]


def cost_of(Q: tuple[Fraction, ...], quaternion: tuple[int, ...]) -> Fraction:
    """Return xᵀQx of the quaternion's rotation, exactly."""
    C = rotation(quaternion)
    x = [C[i][j] for j in range(3) for i in range(3)] + [Fraction(1)]
    return sum(
        (q * x[i] * x[j] * (1 if i == j else 2) for q, (i, j) in zip(Q, UPPER, strict=True)),
        Fraction(0),
    )


def lagrangian(
    Q: tuple[Fraction, ...], bound: Fraction, multipliers: tuple[Fraction, ...]
) -> Matrix:
    """Return H = Q − γJ + Σ λₖAₖ."""
    H = [[Fraction(0)] * 10 for _ in range(10)]
    for q, (i, j) in zip(Q, UPPER, strict=True):
        H[i][j] = H[j][i] = q
    H[9][9] -= bound
    for multiplier, form in zip(multipliers, forms(), strict=True):
        for (i, j), value in form.items():
            H[i][j] += multiplier * value
    return H


def positive_definite(matrix: Sequence[Sequence[Fraction | int]]) -> bool:
    """Return whether a symmetric matrix is positive definite, by Bareiss's elimination.

    In integers, after a common denominator; every pivot is a leading minor (Sylvester).
    """
    n = len(matrix)
    scale = lcm(*(entry.denominator for row in matrix for entry in row))
    M = [[int(entry * scale) for entry in row] for row in matrix]
    previous = 1
    for k in range(n):
        if M[k][k] <= 0:
            return False
        for i in range(k + 1, n):
            for j in range(k + 1, n):
                M[i][j] = (M[i][j] * M[k][k] - M[i][k] * M[k][j]) // previous
        previous = M[k][k]
    return True


def distance(Q: tuple[Fraction, ...], evidence: Evidence) -> Fraction:
    """Return by how much costs of rotations under Q and under the rows differ at most."""
    own = cost_matrix(evidence)
    squares = sum(
        ((q - own[i][j]) ** 2 * (1 if i == j else 2) for q, (i, j) in zip(Q, UPPER, strict=True)),
        Fraction(0),
    )
    # |x|² = 4 times the norm, rounded up.
    return 4 * Fraction(isqrt(int(squares * 4**_ROOT)) + 1, 2**_ROOT)


def check(proof: Proof) -> Checked:
    """Return what a proof proves; nothing is taken on trust."""
    nothing = Fraction(0)
    if not any(proof.quaternion):
        return Checked(False, nothing, nothing, nothing, "the quaternion is zero: no rotation")
    cost = cost_of(proof.Q, proof.quaternion)
    gap, bound = cost - proof.bound, proof.bound

    def answer(proved: bool, reason: str) -> Checked:
        return Checked(proved, bound, cost, gap, reason)

    if cost != proof.cost:
        return answer(False, f"the rotation costs {_g(cost)}, not {_g(proof.cost)}")
    if not positive_definite(lagrangian(proof.Q, proof.bound, proof.multipliers)):
        return answer(False, "H is not positive definite: the multipliers do not prove the bound")
    what = "this Q"
    if proof.evidence is not None:
        apart = distance(proof.Q, proof.evidence)
        bound, gap = bound - apart, gap + 2 * apart
        what = f"these {len(proof.evidence.rows)} rows"
        if apart > GAP / 4:
            return answer(False, f"Q is not that of its rows: costs differ by up to {_g(apart)}")
    if gap > GAP:
        return answer(
            False,
            f"proved is only that every rotation costs {_g(bound)} or more; this one costs "
            f"{_g(cost)} and may not be the best",
        )
    return answer(
        True,
        f"for {what} every rotation costs {_g(bound)} or more; this one costs {_g(cost)}, at "
        f"most {float(gap):.1e} χ² above the best",
    )


def _g(value: Fraction) -> str:
    """Return a number for people, whatever its size."""
    try:
        return f"{float(value):.9g}"
    except OverflowError:
        return "beyond 1e308" if value > 0 else "beyond -1e308"
