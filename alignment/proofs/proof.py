"""An exact check of an alignment proof, in integers and fractions, by itself.

Nothing here is shared with what finds the rotation: no floating point, no numpy, no solver. A
proof is a cost matrix Q, twenty multipliers λ and a bound γ, all rational, and an integer
quaternion. What is checked:

    H = Q − γJ + Σ λₖAₖ is positive definite       (leading minors, fraction-free elimination)
    xᵀAₖx = 0 for every rotation, x = [vec(C); 1]   (the forms below, by construction)

hence f(C) = xᵀQx ≥ γ **for every rotation C and this Q**. The cost of the quaternion's rotation is
recomputed exactly and says how far above γ the best may lie at most. That is all: nothing is said
about the rows behind Q, about the uniqueness of the optimum, or about the vehicle.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from fractions import Fraction
from math import lcm
from pathlib import Path
from typing import Any

from ...filters.errors import DataError

#: First line of a file, so to speak.
FORMAT, VERSION = "certnav alignment proof", 1
#: Order of Q's entries: upper triangle, row by row.
UPPER = tuple((i, j) for i in range(10) for j in range(i, 10))
#: Gap, relative to tr Q, above which a rotation is not called optimal.
GAP = Fraction(1, 10**6)

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
    """

    label: str
    Q: tuple[Fraction, ...]
    multipliers: tuple[Fraction, ...]
    bound: Fraction
    quaternion: tuple[int, ...]
    cost: Fraction

    def __repr__(self) -> str:
        bound, cost = float(self.bound), float(self.cost)
        return f"<Proof '{self.label}': no rotation below {bound:.9g}, this one at {cost:.9g}>"

    def as_dict(self) -> dict[str, Any]:
        """Return it as it is written: fractions as text."""
        return {
            "label": self.label,
            "Q": [str(q) for q in self.Q],
            "multipliers": [str(m) for m in self.multipliers],
            "bound": str(self.bound),
            "quaternion": list(self.quaternion),
            "cost": str(self.cost),
        }


@dataclass(frozen=True)
class Checked:
    """What follows from a proof.

    Attributes
    ----------
    proved : bool
    bound, cost : Fraction
        Every rotation costs `bound` or more; the one at hand costs `cost`, exactly.
    relative_gap : Fraction
        (cost − bound)/tr Q.
    reason : str
        One line: the statement proved, or why nothing is.
    """

    proved: bool
    bound: Fraction
    cost: Fraction
    relative_gap: Fraction
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


def positive_definite(matrix: Matrix) -> bool:
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


def check(proof: Proof) -> Checked:
    """Return what a proof proves; nothing is taken on trust."""
    trace = sum((q for q, (i, j) in zip(proof.Q, UPPER, strict=True) if i == j), Fraction(0))
    nothing = Fraction(0)
    if not any(proof.quaternion):
        return Checked(False, nothing, nothing, nothing, "the quaternion is zero: no rotation")
    cost = cost_of(proof.Q, proof.quaternion)
    gap = (cost - proof.bound) / trace if trace > 0 else nothing

    def answer(proved: bool, reason: str) -> Checked:
        return Checked(proved, proof.bound, cost, gap, reason)

    if trace <= 0:
        return answer(False, "tr Q is not positive: no cost matrix")
    if cost != proof.cost:
        return answer(False, f"the rotation costs {float(cost):.9g}, not {float(proof.cost):.9g}")
    if not positive_definite(lagrangian(proof.Q, proof.bound, proof.multipliers)):
        return answer(False, "H is not positive definite: the multipliers do not prove the bound")
    if gap > GAP:
        return answer(
            False,
            f"proved is only that every rotation costs {float(proof.bound):.9g} or more; this one "
            f"costs {float(cost):.9g} and may not be the best",
        )
    return answer(
        True,
        f"for this Q every rotation costs {float(proof.bound):.9g} or more; this one costs "
        f"{float(cost):.9g}, at most {float(gap):.1e} of tr Q above the best",
    )


def write(path: Path, name: str, proofs: list[Proof]) -> None:
    """Write proofs as JSON."""
    content = {"format": FORMAT, "version": VERSION, "name": name}
    content["proofs"] = [proof.as_dict() for proof in proofs]
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def read(path: Path) -> list[Proof]:
    """Return the proofs of a file.

    Raises
    ------
    DataError
        If it is no proof file, or an entry is missing or no exact number.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        line = error.lineno if isinstance(error, json.JSONDecodeError) else None
        raise DataError("expected a proof file, found no JSON", file=path, line=line) from error
    found = content.get("format") if isinstance(content, dict) else None
    if found != FORMAT or content.get("version") != VERSION:
        raise DataError(
            f"expected '{FORMAT}' version {VERSION}", file=path,
            remedy="write one with certnav align PATH --proof FILE",
        )  # fmt: skip
    proofs = content.get("proofs")
    if not isinstance(proofs, list) or not proofs:
        raise DataError("expected a list of proofs, found none", file=path)
    return [_parsed(entry, number, path) for number, entry in enumerate(proofs, 1)]


def _parsed(entry: Any, number: int, path: Path) -> Proof:
    try:
        proof = Proof(
            str(entry["label"]),
            tuple(_exact(q) for q in entry["Q"]),
            tuple(_exact(m) for m in entry["multipliers"]),
            _exact(entry["bound"]),
            tuple(entry["quaternion"]),
            _exact(entry["cost"]),
        )
        sizes = (len(proof.Q), len(proof.multipliers), len(proof.quaternion))
        if sizes != (55, 20, 4) or not all(type(n) is int for n in proof.quaternion):
            raise ValueError("expected 55 entries of Q, 20 multipliers and 4 integers")
    except (KeyError, TypeError, ValueError, ZeroDivisionError) as error:
        reason = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise DataError(f"proof {number}: {reason}", file=path) from error
    return proof


def _exact(text: Any) -> Fraction:
    """Return a fraction written as text; a JSON number has been rounded by someone."""
    if not isinstance(text, str):
        raise ValueError(f"expected a fraction as text, found {text!r}")
    return Fraction(text)
