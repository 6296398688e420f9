"""The cost of a rotation, its slope and the proof of its uniqueness in integers.

Floating-point numbers are integers over a power of two, and an integer quaternion of any length
is exactly a rotation. Where tr Q is so large, or the margin so small, that the rounding of 2e-13
tr Q which `alignment.solver.fast_solver` allows for hides what is asked, the same questions are
answered here without rounding, in milliseconds instead of microseconds:

1. Newton's method with the exact slope, to far below the last digit of a float;
2. multipliers moved until Hx = 0, H = Q − γJ + Σ λₖAₖ, as exactly;
3. one elimination in integers: H + (δ − λ)I + ¼λ xxᵀ is positive definite. With |x|² = 4 on every
   rotation that is f(R) − f(C) ≥ 4λ(1 − cos⁴(θ/2)) − 4δ for all R.

A factor of Q is better than Q: residuals near zero keep the digits that squaring drops.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from ...filters.rotation import FloatArray
from ..proofs.proof import positive_definite
from .constraints import constraint_matrices, lift, multipliers_between
from .quartic import lagrangian_of
from .refinement import hessian

#: Bits behind the point of quaternions, and least of matrices beyond the scale of Q.
_UNIT, _FINE = 120, 220
#: Newton steps at most; each gains the digits that a float's Hessian has. Moves of multipliers.
_STEPS, _MOVES = 12, 3


@dataclass(frozen=True, eq=False)
class ExactCost:
    """xᵀQx with Q = entries/2**exponent, symmetric integers."""

    entries: np.ndarray
    exponent: int

    @classmethod
    def of(cls, Q: ArrayLike, factor: ArrayLike | None = None) -> ExactCost:
        """Return the cost of a matrix of floats, or of factorᵀ·factor."""
        if factor is not None:
            F, exponent = _integers(np.asarray(factor, dtype=float))
            return cls(F.T @ F, 2 * exponent)
        Q = np.asarray(Q, dtype=float)
        entries, exponent = _integers(Q)
        return cls(entries + entries.T, exponent + 1)

    def pull(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return x and Qx, both times |q|², the latter times 2**exponent too."""
        x = lifted(q)
        return x, self.entries @ x

    def value(self, q: np.ndarray) -> Fraction:
        """Return the cost of a rotation."""
        x, pull = self.pull(q)
        return Fraction(int(x @ pull), int(x[9]) ** 2 << self.exponent)

    def slope(self, q: np.ndarray) -> FloatArray:
        """Return ∂f/∂θ of C·Exp(θ), rounded once, shape (3,)."""
        x, pull = self.pull(q)
        S = x[:9].reshape(3, 3) @ pull[:9].reshape(3, 3).T
        whole = int(x[9]) ** 2 << self.exponent
        pairs = ((2, 1), (0, 2), (1, 0))
        return np.array([float(Fraction(2 * int(S[a, b] - S[b, a]), whole)) for a, b in pairs])

    def refined(self, q: np.ndarray) -> np.ndarray:
        """Return the stationary point near q: to 100 bits, where the Hessian is that of a basin."""
        Q, before = _floats(self), np.inf
        for _ in range(_STEPS):
            inverse = np.linalg.pinv(hessian(Q, rotation_of(q)), rcond=1e-14, hermitian=True)
            step = -inverse @ self.slope(q)
            length = float(np.linalg.norm(step))
            if not length < min(0.5 * before, 0.03):
                break
            q, before = _turned(q, step), length
        return q


def integer_quaternion(C: ArrayLike) -> np.ndarray:
    """Return (w, x, y, z) times 2**120 of a rotation, w ≥ 0, shape (4,) of int."""
    q = Rotation.from_matrix(np.asarray(C, dtype=float)).as_quat(canonical=True, scalar_first=True)
    return np.array([int(Fraction(float(v)) * 2**_UNIT) for v in q], dtype=object)


def lifted(q: np.ndarray) -> np.ndarray:
    """Return |q|²·[vec(R(q)); 1], columns stacked, shape (10,) of int."""
    w, x, y, z = q
    columns = [
        w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y),
        2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x),
        2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z,
    ]  # fmt: skip
    return np.array([*columns, w * w + x * x + y * y + z * z], dtype=object)


def rotation_of(q: np.ndarray) -> FloatArray:
    """Return the rotation matrix of an integer quaternion, rounded once, shape (3, 3)."""
    x = lifted(q)
    return np.array([int(v) / int(x[9]) for v in x[:9]]).reshape(3, 3).T


def proves(cost: ExactCost, q: np.ndarray, gram: FloatArray, margin: float, offset: float) -> bool:
    """Return whether f(R) − f(C) ≥ margin·(1 − cos⁴(θ/2)) − offset is proved for every R.

    Parameters
    ----------
    cost : ExactCost
    q : ndarray, shape (4,) of int
        Quaternion of C.
    gram : ndarray, shape (9, 9)
        A Gram matrix at C that has about this margin; its multipliers are moved to Hx = 0.
    margin, offset : float
        In units of the cost, both positive.
    """
    x = lifted(q)
    found = multipliers_between(_floats(cost), lagrangian_of(gram, rotation_of(q)))
    H, _, bits = _stationary(cost, q, found)
    room, least = (int(Fraction(v) * 2 ** (bits - 1)) for v in (offset, margin))
    unit = np.array([(int(v) << _UNIT) // int(x[9]) for v in x], dtype=object)
    H = H + (least * np.outer(unit, unit) >> 2 * _UNIT + 2)
    # γ, every entry just added and x itself were rounded, by one unit and by 2**-120.
    spare = 100 + (least >> _UNIT - 10)
    for k in range(10):
        H[k, k] += room - spare - least
    return room > spare and positive_definite([[int(v) for v in row] for row in H])


def multipliers_at(cost: ExactCost, q: np.ndarray, found: FloatArray) -> tuple[Fraction, ...]:
    """Return multipliers moved to Hx = 0, twenty, exact as they are."""
    _, moved, bits = _stationary(cost, q, found)
    return tuple(Fraction(int(v), 1 << bits) for v in moved)


def _stationary(
    cost: ExactCost, q: np.ndarray, found: FloatArray
) -> tuple[np.ndarray, np.ndarray, int]:
    """Return H times 2**(bits + 1), the multipliers times 2**bits, and bits; Hx = 0."""
    x, bits = lifted(q), max(cost.exponent, _FINE)
    forms, doubled = _forms()
    back = np.linalg.pinv((forms @ lift(rotation_of(q))).T, rcond=1e-12)
    H = cost.entries << bits + 1 - cost.exponent
    H[9, 9] -= 2 * int(cost.value(q) * 2**bits)
    whole, moved = int(x[9]) << bits + 1, np.zeros(20, dtype=object)
    for _ in range(_MOVES):
        step = _scaled(found, bits)
        # Twice the forms: their halves are integers too.
        moved, H = moved + step, H + np.tensordot(step, doubled, axes=1)
        found = -back @ np.array([int(v) / whole for v in H @ x])
    return H, moved, bits


@lru_cache(maxsize=1)
def _forms() -> tuple[FloatArray, np.ndarray]:
    """Return the constraints' matrices, and twice them in integers."""
    forms = constraint_matrices()
    return forms, (2.0 * forms).astype(int).astype(object)


def _integers(A: FloatArray) -> tuple[np.ndarray, int]:
    """Return integers n and e ≥ 0 with A = n/2**e exactly."""
    mantissa, power = np.frexp(A)
    used = power[A != 0.0]
    exponent = max(int((53 - used).max(initial=0)), 0)
    whole = np.array(
        [int(m * 2.0**53) << exponent + int(p) - 53 if m else 0
         for m, p in zip(mantissa.ravel(), power.ravel(), strict=True)],
        dtype=object,
    )  # fmt: skip
    return whole.reshape(A.shape), exponent


def _floats(cost: ExactCost) -> FloatArray:
    one = 1 << cost.exponent
    return np.array([[int(v) / one for v in row] for row in cost.entries])


def _scaled(values: FloatArray, bits: int) -> np.ndarray:
    return np.array([int(Fraction(float(v)) * 2**bits) for v in values], dtype=object)


def _turned(q: np.ndarray, theta: FloatArray) -> np.ndarray:
    """Return q·(1, θ/2), rounded to the bits that q has."""
    w, x, y, z = q
    d, (a, b, c) = 1 << _UNIT, _scaled(0.5 * theta, _UNIT)
    product = [
        w * d - x * a - y * b - z * c, w * a + x * d + y * c - z * b,
        w * b - x * c + y * d + z * a, w * c + x * b - y * a + z * d,
    ]  # fmt: skip
    return np.array([v >> _UNIT for v in product], dtype=object)
