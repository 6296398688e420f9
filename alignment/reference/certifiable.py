"""Certifiable alignment as published: relax, solve, round, refine, prove.

The semidefinite relaxation finds the basin, Newton's method the bottom of it, and the
certificate is made anew at the refined rotation from multipliers moved along with it.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...filters.rotation import FloatArray
from ..observability import observability
from ..problem import AlignmentProblem
from ..proofs.certificate import Certificate, certify
from ..result import AlignmentResult
from ..solver.constraints import ALL, lagrangian, multipliers_between
from ..solver.fast_solver import LocalMinima
from ..solver.refinement import Minimum, newton
from ..status import AlignmentStatus
from ..verdict import optimal, unique
from .sdp import DualSolution, rotations_from_moments, solve_dual


@dataclass(frozen=True, eq=False)
class CertifiedMinimum:
    """A rotation with the proof of what it is; a `ProvedMinimum`.

    Attributes
    ----------
    refined : Minimum
        Rotation, cost, gradient and Hessian after Newton's method.
    certificate : Certificate
    dual : DualSolution
        The relaxation's solution.
    rounded : ndarray, shape (3, 3)
        Rotation nearest to the rank-one part of the moment matrix, before refinement.
    """

    refined: Minimum
    certificate: Certificate
    dual: DualSolution
    rounded: FloatArray

    def __repr__(self) -> str:
        return f"<CertifiedMinimum: {self.certificate!r}>"

    @property
    def C(self) -> FloatArray:
        """The rotation."""
        return self.refined.C

    @property
    def cost(self) -> float:
        """f(C)."""
        return self.refined.cost

    @property
    def scale(self) -> float:
        """Of Q: its trace if semidefinite."""
        return self.certificate.scale

    @property
    def gap(self) -> float:
        """(cost − proved lower bound)/scale ≥ 0."""
        return self.certificate.relative_gap

    @property
    def best_margin(self) -> float:
        """4λ₂ of the Lagrangian (`alignment.proofs.certificate`), 0 where more than λ₁ is zero."""
        return 4.0 * self.certificate.second_eigenvalue if self.certificate.corank == 1 else 0.0

    @property
    def status(self) -> AlignmentStatus:
        """What follows from Q alone."""
        return self.certificate.status

    def covariance(self) -> FloatArray:
        """Return the covariance of θ, C_true = C·Exp(θ) [rad²], w axes, if f is χ².

        The Hessian is then twice the information. Infinite where f is flat.
        """
        values, axes = np.linalg.eigh(0.5 * self.refined.hessian)
        with np.errstate(divide="ignore"):
            return (axes / np.maximum(values, 0.0)) @ axes.T

    def multipliers(self, Q: ArrayLike) -> FloatArray:
        """Return the λₖ of all twenty constraints that make the same Lagrangian."""
        proof = self.certificate
        H = lagrangian(Q, proof.primal_cost, proof.multipliers, proof.families)
        return multipliers_between(Q, H)


def certified_minimum(
    Q: ArrayLike, *, factor: ArrayLike | None = None, families: Collection[str] = ALL
) -> CertifiedMinimum:
    """Minimise xᵀQx over the rotations, x = [vec(C); 1], and prove it.

    Parameters
    ----------
    Q : array_like, shape (10, 10)
        Symmetric; need not be semidefinite.
    factor : array_like, shape (10, 10), optional
        With factorᵀ·factor = Q, for the last digits of the refinement.
    families : collection of {'columns', 'rows', 'handedness'}
        Constraints relaxed; anything less than all is for the paper's figures.
    """
    dual = solve_dual(Q, families)
    starts = rotations_from_moments(dual.Z)
    best: tuple[Minimum, Certificate] | None = None
    for start in starts:
        refined = newton(Q, start, factor=factor)
        proof = certify(Q, refined.C, dual.multipliers, dual.dual_cost, dual.families)
        if best is None or proof.relative_gap < best[1].relative_gap:
            best = refined, proof
        if best[1].status is AlignmentStatus.CERTIFIED:
            break
    assert best is not None
    return CertifiedMinimum(*best, dual, starts[0])


def align_sdp(
    problem: AlignmentProblem, *, families: Collection[str] = ALL, vel_sigma: float = 0.0
) -> AlignmentResult:
    """Align by the semidefinite relaxation, and ask what the paper asks: optimal, and unique?

    Neither rivals under noise nor a bound nor χ² are looked at: `bound` is π, `rivals` are none,
    and the covariance is as the weights have it. `minimum` is the `CertifiedMinimum`.

    Parameters
    ----------
    problem : AlignmentProblem
    families : collection of str
        As for `certified_minimum`.
    vel_sigma : float
        1σ per axis of the local velocities [m/s], for the observability test.
    """
    minimum = certified_minimum(problem.Q, factor=problem.factor, families=families)
    seen = observability(problem.Q, vel_sigma=vel_sigma, information=problem.information)
    return AlignmentResult(
        minimum.C, minimum.covariance(), np.pi, (optimal(minimum), unique(minimum, seen)),
        minimum.cost, problem.dof, problem.nuisance_at(minimum.C), minimum,
        LocalMinima(np.empty((0, 3, 3)), np.empty(0)), seen, problem,
    )  # fmt: skip
