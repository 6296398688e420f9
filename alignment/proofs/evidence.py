"""The rows behind a proof, and the cost matrix that follows from them, without floating point.

Like `alignment.proofs.proof` this shares nothing with what finds the rotation. A row says

    z = e·C v − drift + noise,        r = [v ⊗ e, −z]·x,   x = [vec(C); 1],

and Q is what is left of Σ r²/σ² when the drift is the one that suits best: constant, linear in
time, one for every epoch, or a random walk of variance q²t; likewise errors that all rows share,
r + common·u with u² added to the sum. The walk is a Kalman filter, row by
row in the order of time, of the sums instead of the rows (`alignment.clock_walk` does it in
floating point). Numbers are integers over 2**256, each division rounded to that: an error that
some thousand rows of up to 2**80 leave below 2**-100.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

#: Bits behind the point.
_BITS = 256
_ONE = 1 << _BITS
#: Clock models, and rows, prior rows and shared errors that a window may have.
CLOCKS = ("constant", "linear", "random-walk", "per-epoch")
MOST_ROWS, MOST_PRIORS, MOST_SHARED = 10_000, 100, 10


@dataclass(frozen=True)
class Evidence:
    """Rows of one window, as they were believed.

    Attributes
    ----------
    rows : tuple of tuple of float
        (e₁, e₂, e₃, v₁, v₂, v₃ [m/s], z [m/s], σ [m/s], time [s]), then what 1σ of each shared
        error does to z [m/s].
    epoch : tuple of int
        Of each row.
    clock : str
    q : float
        Of the random walk [m/s/√s]; 0 of the others.
    priors : tuple of tuple of float
        Rows of unit variance on x, ten numbers each.
    """

    rows: tuple[tuple[float, ...], ...]
    epoch: tuple[int, ...]
    clock: str
    q: float
    priors: tuple[tuple[float, ...], ...] = field(default=())

    @property
    def shared(self) -> int:
        """Errors that all rows share."""
        return len(self.rows[0]) - 9

    def as_dict(self) -> dict[str, Any]:
        """Return it as it is written: floats in hexadecimal, which is exact."""
        return {
            "clock": self.clock,
            "clock_walk": self.q.hex(),
            "shared": self.shared,
            "rows": [" ".join(v.hex() for v in row) for row in self.rows],
            "epoch": list(self.epoch),
            "priors": [" ".join(v.hex() for v in row) for row in self.priors],
        }


def parsed(entry: Any) -> Evidence:
    """Return what `as_dict` wrote.

    Raises
    ------
    ValueError, KeyError, TypeError
        If it is something else.
    """
    shared = entry["shared"]
    if type(shared) is not int or not 0 <= shared <= MOST_SHARED:
        raise ValueError(f"expected at most {MOST_SHARED} shared errors")
    rows = tuple(_floats(text, 9 + shared) for text in _listed(entry["rows"], MOST_ROWS))
    epoch = tuple(_listed(entry["epoch"], MOST_ROWS))
    priors = tuple(_floats(text, 10) for text in _listed(entry["priors"], MOST_PRIORS))
    (q,) = _floats(entry["clock_walk"], 1)
    if not rows or len(rows) != len(epoch) or not all(type(k) is int for k in epoch):
        raise ValueError(f"expected rows with an epoch each, found {len(rows)} and {len(epoch)}")
    if entry["clock"] not in CLOCKS or q < 0.0:
        raise ValueError(f"expected a clock model of {', '.join(CLOCKS)} with q ≥ 0")
    if not all(1e-12 < row[7] < 1e12 for row in rows):
        raise ValueError("expected every σ between 1e-12 and 1e12 m/s")
    if not all(abs(v) < 1e12 for row in (*rows, *priors) for v in row):
        raise ValueError("expected rows of numbers below 1e12")
    return Evidence(rows, epoch, entry["clock"], q, priors)


def _listed(found: Any, most: int) -> list[Any]:
    if not isinstance(found, list) or len(found) > most:
        raise ValueError(f"expected a list of at most {most}")
    return found


def _floats(text: Any, count: int) -> tuple[float, ...]:
    if not isinstance(text, str) or len(text) > 40 * count:
        raise ValueError(f"expected {count} hexadecimal floats as text")
    try:
        values = tuple(float.fromhex(word) for word in text.split(" "))
    except OverflowError as error:
        raise ValueError("expected finite numbers") from error
    if len(values) != count or not all(v - v == 0.0 for v in values):
        raise ValueError(f"expected {count} finite hexadecimal floats")
    return values


def cost_matrix(evidence: Evidence) -> list[list[Fraction]]:
    """Return Q, 10×10."""
    clocks = 2 if evidence.clock == "linear" else 1
    groups: dict[int, list[int]] = {}
    for k, epoch in enumerate(evidence.epoch):
        groups.setdefault(epoch if evidence.clock == "per-epoch" else 0, []).append(k)
    q = evidence.q if evidence.clock == "random-walk" else 0.0
    size = evidence.shared + 10
    Q = [[0] * size for _ in range(size)]
    for group in groups.values():
        part = _without(_sums(evidence, group, clocks, q), clocks)
        Q = [[a + b for a, b in zip(*rows, strict=True)] for rows in zip(Q, part, strict=True)]
    for k in range(evidence.shared):
        Q[k][k] += _ONE
    Q = _without(Q, evidence.shared)
    for prior in evidence.priors:
        row = [_fixed(v) for v in prior]
        Q = [[Q[i][j] + (row[i] * row[j] >> _BITS) for j in range(10)] for i in range(10)]
    return [[Fraction(entry, _ONE) for entry in row] for row in Q]


def _sums(evidence: Evidence, group: list[int], clocks: int, q: float) -> list[list[int]]:
    """Return Σ of the decorrelated rows' products, the clock's columns first."""
    order = sorted(group, key=lambda k: evidence.rows[k][8])
    size = clocks + evidence.shared + 10
    sums, mean = [[0] * size for _ in range(size)], [0] * size
    variance, before, walk = 0, evidence.rows[order[0]][8], Fraction(q) ** 2
    start = Fraction(before)
    for k in order:
        sigma, time = evidence.rows[k][7:9]
        variance += _fixed(walk * (Fraction(time) - Fraction(before)))
        before, noise = time, _fixed(Fraction(sigma) ** 2)
        total = variance + noise
        columns = [-_ONE, -_fixed(Fraction(time) - start)][:clocks] + _design(evidence.rows[k])
        left = [a - b for a, b in zip(columns, mean, strict=True)]
        for i in range(size):
            for j in range(i + 1):
                sums[i][j] += left[i] * left[j] // total
            if variance:
                mean[i] += left[i] * variance // total
        variance = variance * noise // total
    return [[sums[max(i, j)][min(i, j)] for j in range(size)] for i in range(size)]


def _design(row: tuple[float, ...]) -> list[int]:
    e, v = [Fraction(c) for c in row[:3]], [Fraction(c) for c in row[3:6]]
    shared = [_fixed(c) for c in row[9:]]
    return shared + [_fixed(b * a) for b in v for a in e] + [-_fixed(Fraction(row[6]))]


def _without(sums: list[list[int]], clocks: int) -> list[list[int]]:
    """Return the Schur complement of the clock's columns, one after the other."""
    for k in range(clocks):
        pivot = sums[k][k]
        if pivot <= 0:
            continue  # a rate of rows at one time: nothing to remove
        sums = [
            [sums[i][j] - sums[i][k] * sums[k][j] // pivot for j in range(len(sums))]
            for i in range(len(sums))
        ]
    return [row[clocks:] for row in sums[clocks:]]


def _fixed(value: Fraction | float) -> int:
    exact = Fraction(value)
    return (exact.numerator << _BITS) // exact.denominator
