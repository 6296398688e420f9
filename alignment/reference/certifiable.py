"""Certifiable alignment: relax, solve, round, refine, prove.

The semidefinite relaxation finds the basin, Newton's method the bottom of it, and the
certificate is made anew at the refined rotation from multipliers moved along with it.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...filters.rotation import FloatArray
from ..observability import Geometry, Observability, observability
from ..problem import AlignmentProblem
from ..proofs.certificate import AlignmentStatus, Certificate, certify
from ..solver.constraints import ALL
from ..solver.refinement import Minimum, newton
from .sdp import DualSolution, rotations_from_moments, solve_dual


@dataclass(frozen=True, eq=False)
class CertifiedMinimum:
    """A rotation with the proof of what it is.

    Attributes
    ----------
    minimum : Minimum
        Refined rotation, cost, gradient and Hessian.
    certificate : Certificate
    dual : DualSolution
        The relaxation's solution.
    rounded : ndarray, shape (3, 3)
        Rotation nearest to the rank-one part of the moment matrix, before refinement.
    """

    minimum: Minimum
    certificate: Certificate
    dual: DualSolution
    rounded: FloatArray


@dataclass(frozen=True, eq=False)
class SdpAlignment:
    """The attitude of the local frame, and what is known about it.

    Attributes
    ----------
    status : AlignmentStatus
        What certificate and observability say together.
    C_ew : ndarray, shape (3, 3)
        Local axes to ECEF.
    cost : float
        χ² of the window.
    dof : int
        Its degrees of freedom; cost/dof far from one says that clock model or σ are wrong,
        which no certificate does.
    nuisance : ndarray, shape (m,)
        Clock drift cδṫ [m/s] first, in the order of the problem's columns.
    observability : Observability
    solution : CertifiedMinimum
    """

    status: AlignmentStatus
    C_ew: FloatArray
    cost: float
    dof: int
    nuisance: FloatArray
    observability: Observability
    solution: CertifiedMinimum

    @property
    def certificate(self) -> Certificate:
        """The proof of optimality."""
        return self.solution.certificate


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
    minimum = newton(Q, starts[0], factor=factor)
    certificate = certify(Q, minimum.C, dual)
    for start in starts[1:]:
        if certificate.status is AlignmentStatus.CERTIFIED:
            break
        other = newton(Q, start, factor=factor)
        again = certify(Q, other.C, dual)
        if again.relative_gap < certificate.relative_gap:
            minimum, certificate = other, again
    return CertifiedMinimum(minimum, certificate, dual, starts[0])


def align_sdp(
    problem: AlignmentProblem, *, families: Collection[str] = ALL, vel_sigma: float = 0.0
) -> SdpAlignment:
    """Align by the semidefinite relaxation.

    Parameters
    ----------
    problem : AlignmentProblem
    families : collection of str
        As for `certified_minimum`.
    vel_sigma : float
        1σ per axis of the local velocities [m/s], for the observability test.
    """
    solution = certified_minimum(problem.Q, factor=problem.factor, families=families)
    seen = observability(problem.Q, vel_sigma=vel_sigma, information=problem.information)
    C_ew = solution.minimum.C
    return SdpAlignment(
        _status(solution.certificate.status, seen.geometry),
        C_ew,
        solution.minimum.cost,
        problem.dof,
        problem.nuisance_at(C_ew),
        seen,
        solution,
    )


def _status(proved: AlignmentStatus, geometry: Geometry) -> AlignmentStatus:
    """Return the weaker of the two: unique in exact arithmetic may be ambiguous under noise."""
    if geometry is Geometry.UNOBSERVABLE:
        return AlignmentStatus.UNOBSERVABLE
    if geometry is Geometry.MIRROR and proved is AlignmentStatus.CERTIFIED:
        return AlignmentStatus.AMBIGUOUS
    return proved


def attitude_covariance(minimum: Minimum) -> FloatArray:
    """Return the covariance of the right-hand error θ, C_true = C Exp(θ) [rad²], w axes.

    The cost is χ², so that its Hessian is twice the information. Infinite where f is flat.

    Parameters
    ----------
    minimum : Minimum
        Of a problem whose rows are weighted with their true σ.
    """
    values, axes = np.linalg.eigh(0.5 * minimum.hessian)
    with np.errstate(divide="ignore"):
        return (axes / np.maximum(values, 0.0)) @ axes.T
