"""Certifiable alignment as published: relax, solve, round, refine, prove.

The semidefinite relaxation finds the basin, Newton's method the bottom of it, and the
certificate is made anew at the refined rotation from multipliers moved along with it. With all
constraints the status is decided where that of the fast solver is, from the rotation found here:
the same of the same problem. The certificate of the relaxation's own multipliers stands beside it.
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
from ..solver.fast_solver import FastMinimum, LocalMinima, proved_at
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
        Of the relaxation's multipliers.
    dual : DualSolution
        The relaxation's solution.
    rounded : ndarray, shape (3, 3)
        Rotation nearest to the rank-one part of the moment matrix, before refinement.
    proof : FastMinimum or None
        From the rotation, with the multipliers that prove most; None where not all constraints
        were relaxed.
    """

    refined: Minimum
    certificate: Certificate
    dual: DualSolution
    rounded: FloatArray
    proof: FastMinimum | None

    def __repr__(self) -> str:
        return f"<CertifiedMinimum {self.status.name}: {self.certificate!r}>"

    @property
    def C(self) -> FloatArray:
        """The rotation."""
        return self.refined.C if self.proof is None else self.proof.C

    @property
    def cost(self) -> float:
        """f(C)."""
        return self.refined.cost if self.proof is None else self.proof.cost

    @property
    def scale(self) -> float:
        """Of Q: its trace if semidefinite."""
        return self.certificate.scale

    @property
    def gap(self) -> float:
        """Proved: no rotation costs less by more than this."""
        return self.certificate.growth.gap if self.proof is None else self.proof.gap

    @property
    def best_margin(self) -> float:
        """t, the margin of uniqueness; not positive: other rotations may cost as little."""
        return self.certificate.growth.margin if self.proof is None else self.proof.best_margin

    @property
    def region(self) -> float:
        """Proved: every rotation that costs less is within this angle [rad]."""
        return self.certificate.growth.region if self.proof is None else self.proof.region

    @property
    def status(self) -> AlignmentStatus:
        """What follows from Q alone."""
        return self.certificate.status if self.proof is None else self.proof.status

    def covariance(self) -> FloatArray:
        """Return the covariance of θ, C_true = C·Exp(θ) [rad²], w axes, if f is χ².

        The Hessian is then twice the information. Infinite where f is flat.
        """
        values, axes = np.linalg.eigh(0.5 * self.refined.hessian)
        with np.errstate(divide="ignore"):
            return (axes / np.maximum(values, 0.0)) @ axes.T

    def multipliers(self, Q: ArrayLike) -> FloatArray:
        """Return the λₖ of all twenty constraints that make the same Lagrangian."""
        if self.proof is not None:
            return self.proof.multipliers(Q)
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
    best: CertifiedMinimum | None = None
    for start in starts:
        refined = newton(Q, start, factor=factor)
        certificate = certify(Q, refined.C, dual.multipliers, dual.dual_cost, dual.families)
        proof = proved_at(Q, refined.C, factor=factor) if dual.families == ALL else None
        found = CertifiedMinimum(refined, certificate, dual, starts[0], proof)
        if best is None or found.gap < best.gap:
            best = found
        if best.status is AlignmentStatus.CERTIFIED:
            break
    assert best is not None
    return best


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
