"""What multipliers prove about a rotation, whoever found the two.

For any multipliers λ and γ = f(C), H = Q − γJ + Σ λₖAₖ gives xᵀHx = f(R) − γ on every rotation R,
and |x|² = 4 there. Hence, with no assumption on the solver,

    min f ≥ γ + 4·min(0, λ_min(H)),

and if also Hx = 0 at x = [vec(C); 1] (stationarity, the KKT condition of the lifted problem) and
H is semidefinite with one zero eigenvalue, C is the only optimum:

    f(R) − f(C) ≥ 4 λ₂ (1 − cos⁴(θ/2)),          θ the angle between R and C,

λ₂ the second eigenvalue (Song et al. test λ₁/λ₂ < 1e-6). In floating point Hx is not zero, and
what is left of it may hide another optimum: with λ the smallest eigenvalue of H across x this is

    f(R) − f(C) ≥ 4λ a² − 4|Hx| w² a,             w = cos(θ/2), a² = 1 − w⁴,

which `alignment.status.Growth` turns into a status. Optimal is not correct: a wrong clock model or
a mirrored geometry is certified just as readily, see `alignment.observability`.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...filters.rotation import FloatArray
from ..solver.constraints import ALL, constraint_matrices, lagrangian, lift
from ..solver.fast_solver import ROUNDING
from ..solver.refinement import cost, cost_scale
from ..status import AlignmentStatus, Growth

#: Eigenvalues of H below this share of tr Q count as zero.
ZERO_EIGENVALUE = 1e-10
#: The paper's threshold on the ratio of the two smallest eigenvalues.
PAPER_RATIO = 1e-6


@dataclass(frozen=True, eq=False)
class Certificate:
    """The proof and its numbers; `scale` is tr Q, which 'relative' refers to.

    Attributes
    ----------
    status : AlignmentStatus
        CERTIFIED, AMBIGUOUS, NOT_TIGHT or NUMERICAL: what follows from Q alone.
    growth : Growth
        What it follows from.
    primal_cost : float
        f at the rotation.
    lower_bound : float
        Proved: no rotation costs less. Rounding of the eigenvalues is allowed for.
    dual_cost : float
        γ of the solver, for comparison.
    relative_gap : float
        (primal_cost − lower_bound)/scale ≥ 0.
    kkt_residual : float
        |Hx|/scale at the rotation.
    eigenvalues : ndarray, shape (10,)
        Of H, ascending.
    corank : int
        How many of them are zero; 1 where the optimum is unique.
    scale : float
    multipliers : ndarray, shape (m,)
        Those that H is made with.
    families : tuple of str
        Constraint families they belong to.
    """

    status: AlignmentStatus
    growth: Growth
    primal_cost: float
    lower_bound: float
    dual_cost: float
    relative_gap: float
    kkt_residual: float
    eigenvalues: FloatArray
    corank: int
    scale: float
    multipliers: FloatArray
    families: tuple[str, ...]

    def __repr__(self) -> str:
        return (
            f"<Certificate {self.status.name}: cost {self.primal_cost:.6g}, "
            f"relative gap {self.relative_gap:.1e}, λ₁ {self.smallest_eigenvalue:.1e}, "
            f"λ₂ {self.second_eigenvalue:.2g}>"
        )

    @property
    def smallest_eigenvalue(self) -> float:
        """λ₁ of H; zero to rounding at a proved optimum."""
        return float(self.eigenvalues[0])

    @property
    def second_eigenvalue(self) -> float:
        """λ₂ of H; the stronger the geometry, the larger."""
        return float(self.eigenvalues[1])

    @property
    def eigenvalue_ratio(self) -> float:
        """|λ₁|/|λ₂| by size, the paper's figure; 0/0 counts as 1."""
        return eigenvalue_ratio(self.eigenvalues)


def eigenvalue_ratio(eigenvalues: ArrayLike) -> float:
    """Return the ratio of the two eigenvalues smallest in size (Song et al., rank test)."""
    smallest, second = np.sort(np.abs(eigenvalues))[:2]
    return float(smallest / second) if second > 0.0 else 1.0


def stationary_multipliers(
    Q: ArrayLike, C: ArrayLike, multipliers: ArrayLike, families: Collection[str] = ALL
) -> FloatArray:
    """Return the multipliers nearest to the given ones with Hx = 0 at the rotation C.

    After Newton's method the solver's multipliers belong to a point 1e-6° away. Least squares in
    the ten equations Σ δₖAₖx = −Hx moves them by as little; exact where the gradient is zero.
    """
    x = lift(C)
    multipliers = np.asarray(multipliers, dtype=float)
    residual = lagrangian(Q, cost(Q, C), multipliers, families) @ x
    forms = constraint_matrices(families) @ x
    return multipliers - np.linalg.lstsq(forms.T, residual, rcond=1e-12)[0]


def certify(
    Q: ArrayLike,
    C: ArrayLike,
    multipliers: ArrayLike,
    dual_cost: float,
    families: Collection[str] = ALL,
) -> Certificate:
    """Return what multipliers prove about the rotation C.

    Parameters
    ----------
    Q : array_like, shape (10, 10)
        Symmetric.
    C : array_like, shape (3, 3)
        Any rotation, however found.
    multipliers : array_like, shape (m,)
        To start from; moved to stationarity they decide about uniqueness, the better of both
        about the bound.
    dual_cost : float
        γ that goes with them.
    families : collection of str
        Constraints that they belong to, see `constraint_matrices`.
    """
    Q = np.asarray(Q, dtype=float)
    scale, value = cost_scale(Q), cost(Q, C)
    moved = stationary_multipliers(Q, C, multipliers, families)
    H = lagrangian(Q, value, moved, families)
    eigenvalues = np.asarray(np.linalg.eigvalsh(H), dtype=float)
    as_given = np.asarray(
        np.linalg.eigvalsh(lagrangian(Q, dual_cost, multipliers, families)), dtype=float
    )
    bound = max(_bound(value, eigenvalues), _bound(dual_cost, as_given))
    residual = float(np.linalg.norm(H @ lift(C)))
    gap = max(value - bound, 0.0) / scale
    corank = int(np.sum(eigenvalues < ZERO_EIGENVALUE * scale))
    rounding = ROUNDING * scale
    growth = Growth(4.0 * _across(H, lift(C)) - rounding, 2.0 * residual + rounding, scale)
    return Certificate(
        growth.status, growth, value, bound, dual_cost, gap, residual / scale, eigenvalues, corank,
        scale, moved, tuple(families),
    )  # fmt: skip


def _across(H: FloatArray, x: FloatArray) -> float:
    """Return the smallest eigenvalue of H among the vectors orthogonal to x."""
    rest = np.linalg.qr(np.column_stack([x, np.eye(10)]))[0][:, 1:]
    return float(np.linalg.eigvalsh(rest.T @ H @ rest)[0])


def _bound(gamma: float, eigenvalues: FloatArray) -> float:
    """Return γ + 4 λ_min with the rounding error of λ_min taken against us."""
    rounding = 10.0 * np.finfo(float).eps * float(np.abs(eigenvalues).max())
    return gamma + 4.0 * (min(float(eigenvalues[0]), 0.0) - rounding)
