"""What may be believed of an alignment: five verdicts kept apart, and one that needs them all.

    optimal      the rotation is proved to have the lowest cost          (gap)
    unique       and no other rotation has the same                      (t > 0)
    unambiguous  nor one that noise could have preferred                 (runner-up within χ²)
    consistent   the rows agree with each other and with their weights   (χ² per degree of freedom)
    bounded      every rotation within the χ² region is near             (certified attitude bound)

The first two are proofs about a matrix and say nothing about the world: with a wrong clock model,
a mirrored geometry or clustered outliers the certified optimum is wrong by tens of degrees. Only a
result that passes all five may start a filter.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.stats import chi2

from ..filters.errors import AlignmentError, ConfigError
from ..filters.rotation import FloatArray
from .observability import Geometry, Observability, observability
from .problem import AlignmentProblem
from .proofs.certificate import AlignmentStatus
from .solver.attitude_bound import attitude_bound, region_threshold
from .solver.fast_solver import FastMinimum, LocalMinima, fast_minimum, local_minima
from .solver.refinement import rotation_angle


@dataclass(frozen=True)
class VerdictLimits:
    """Where the verdicts draw the line.

    Parameters
    ----------
    bound : float
        Largest attitude bound that may start a filter [rad].
    probability : float
        Of the χ² region with three degrees of freedom that the bound encloses; 3σ.
    ambiguity : float
        Cost [χ²] below which another minimum is a rival. The default is the 1 − 10⁻⁶ quantile for
        nine degrees of freedom: no noise makes the true basin lose by more, however curved the
        problem.
    consistency : float
        Probability with which a window that agrees with its weights passes the χ² test.
    redundancy : int
        Least degrees of freedom for that test to mean something.
    """

    bound: float = float(np.radians(10.0))
    probability: float = 0.9973
    ambiguity: float = round(region_threshold(1.0 - 1e-6, 9), 1)
    consistency: float = 0.999
    redundancy: int = 3

    def __post_init__(self) -> None:
        for name, ok in (
            ("bound", 0.0 < self.bound < np.pi),
            ("probability", 0.0 < self.probability < 1.0),
            ("consistency", 0.0 < self.consistency < 1.0),
            ("ambiguity", self.ambiguity > 0.0),
            ("redundancy", self.redundancy >= 1),
        ):
            if not ok:
                raise ConfigError(f"verdict limits: {name} = {getattr(self, name)!r} out of range")


@dataclass(frozen=True)
class Verdict:
    """One question, its answer and the number behind it.

    Attributes
    ----------
    name : str
    passed : bool
    value, limit : float
        What was found and what it was compared with.
    message : str
        One line; says what is missing where it did not pass.
    """

    name: str
    passed: bool
    value: float
    limit: float
    message: str


@dataclass(frozen=True, eq=False)
class AlignmentResult:
    """The attitude of the local frame, and what may be believed of it.

    Attributes
    ----------
    C_ew : ndarray, shape (3, 3)
        Local axes to ECEF.
    cov_w : ndarray, shape (3, 3)
        Covariance of θ, C_true = C_ew·Exp(θ) [rad²], from the Hessian, times χ²/dof where that
        exceeds one.
    bound : float
        Every rotation within the χ² region is within this angle [rad]; π if nothing is proved.
    optimal, unique, unambiguous, consistent, bounded : Verdict
    cost : float
        χ² of the rows at C_ew.
    dof : int
        Its degrees of freedom.
    nuisance : ndarray, shape (m,)
        Clock drift cδṫ [m/s] first, in the order of the problem's columns.
    minimum : FastMinimum
    rivals : LocalMinima
        Other minima, with their costs, the lowest first.
    observability : Observability
    problem : AlignmentProblem
        What was minimised.
    """

    C_ew: FloatArray
    cov_w: FloatArray
    bound: float
    optimal: Verdict
    unique: Verdict
    unambiguous: Verdict
    consistent: Verdict
    bounded: Verdict
    cost: float
    dof: int
    nuisance: FloatArray
    minimum: FastMinimum
    rivals: LocalMinima
    observability: Observability
    problem: AlignmentProblem
    extra: tuple[Verdict, ...] = field(default=())

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """All of them, in the order in which they build on each other."""
        return (
            self.optimal, self.unique, self.unambiguous, self.consistent, self.bounded,
            *self.extra,
        )  # fmt: skip

    @property
    def passed(self) -> bool:
        """The overall verdict: this attitude may start a filter."""
        return all(verdict.passed for verdict in self.verdicts)

    @property
    def failed(self) -> tuple[Verdict, ...]:
        """The verdicts that did not pass."""
        return tuple(verdict for verdict in self.verdicts if not verdict.passed)

    @property
    def message(self) -> str:
        """One line for the log: the attitude's bound, or what it is waiting for."""
        if self.passed:
            return f"aligned: {self.bounded.message}, {self.consistent.message}"
        return "not aligned: " + "; ".join(verdict.message for verdict in self.failed)

    def require(self) -> AlignmentResult:
        """Return self if it passed.

        Raises
        ------
        AlignmentError
            With the message of the verdicts that did not.
        """
        if not self.passed:
            raise AlignmentError(self.message)
        return self


def align(
    problem: AlignmentProblem,
    *,
    limits: VerdictLimits | None = None,
    vel_sigma: float = 0.0,
    backend: str | None = None,
) -> AlignmentResult:
    """Find the attitude of the local frame and judge it.

    Parameters
    ----------
    problem : AlignmentProblem
        Its cost must be χ²: rows weighted with their σ.
    limits : VerdictLimits, optional
    vel_sigma : float
        1σ per axis of the local velocities [m/s], for the observability test.
    backend : {'numba', 'numpy'}, optional
        Of the solver.
    """
    limits = limits or VerdictLimits()
    Q = problem.Q
    minimum = fast_minimum(Q, backend=backend)
    seen = observability(Q, vel_sigma=vel_sigma, information=problem.information)
    rivals = _others(minimum, local_minima(Q, backend=backend))
    cost = problem.cost(minimum.C)
    # Weights that are too optimistic make the region too small; never too large the other way.
    inflation = max(1.0, cost / problem.dof) if problem.dof > 0 else 1.0
    threshold = inflation * region_threshold(limits.probability)
    bound = attitude_bound(minimum, threshold, backend=backend)
    return AlignmentResult(
        minimum.C, inflation * minimum.covariance(), bound,
        _optimal(minimum), _unique(minimum, seen),
        _unambiguous(minimum, rivals, inflation * limits.ambiguity),
        _consistent(cost, problem.dof, limits), _bounded(bound, limits.bound, seen),
        cost, problem.dof, problem.nuisance_at(minimum.C), minimum, rivals, seen, problem,
    )  # fmt: skip


def _others(minimum: FastMinimum, found: LocalMinima) -> LocalMinima:
    """Return the minima that are not the one at hand (0.6° counts as the same)."""
    other = rotation_angle(minimum.C, found.C) > 0.01
    return LocalMinima(found.C[other], found.cost[other])


def _optimal(minimum: FastMinimum) -> Verdict:
    passed = minimum.status is not AlignmentStatus.NOT_TIGHT
    text = f"optimum {'proved' if passed else 'not proved'}, relative gap {minimum.gap:.1e}"
    return Verdict("optimal", passed, minimum.gap, 1e-9, text)


def _unique(minimum: FastMinimum, seen: Observability) -> Verdict:
    t = minimum.margin if minimum.margin <= 0.0 else max(minimum.margin, minimum.uniqueness)
    determined = seen.geometry not in (Geometry.UNOBSERVABLE, Geometry.MIRROR)
    passed = t > 0.0 and determined
    if passed:
        text = f"the only optimum, t = {t:.2g}"
    elif determined:
        text = f"other rotations cost as little, t = {t:.2g}"
    else:
        text = (
            f"{seen.geometry.value}; velocities span {seen.rank_v}, lines of sight "
            f"{seen.rank_n} dimensions — {_remedy(seen)}"
        )
    return Verdict("unique", passed, t, 0.0, text)


def _remedy(seen: Observability) -> str:
    if seen.rank_v < 2:
        return "needs a turn or a change of speed"
    if seen.rank_n < 2:
        return "needs more satellites or a steadier clock model"
    if seen.rank_v == seen.rank_n == 2:
        return "needs a third satellite, a slope or an up prior"
    return "needs a turn, a change of speed or more satellites"


def _unambiguous(minimum: FastMinimum, rivals: LocalMinima, limit: float) -> Verdict:
    excess = rivals.cost - minimum.cost
    near = int(np.sum(excess < limit))
    value = float(excess[0]) if len(excess) else np.inf
    if not near:
        text = f"runner-up at χ² +{value:.3g}" if len(excess) else "no other minimum found"
        return Verdict("unambiguous", True, value, limit, text)
    angle = np.degrees(rotation_angle(minimum.C, rivals.C[0]))
    text = (
        f"{near} other minima within χ² +{limit:.0f}, the next at +{max(value, 0.0):.2g}, "
        f"{angle:.0f}° away"
    )
    return Verdict("unambiguous", False, value, limit, text)


def _consistent(cost: float, dof: int, limits: VerdictLimits) -> Verdict:
    if dof < limits.redundancy:
        text = f"{dof} redundant rows, {limits.redundancy} are needed to notice an error"
        return Verdict("consistent", False, np.inf, 0.0, text)
    limit = float(chi2.ppf(limits.consistency, dof)) / dof
    ratio = cost / dof
    text = f"χ²/dof {ratio:.2f} at {dof}"
    if ratio > limit:
        text += (
            f" (limit {limit:.2f}): outliers, a clock less steady than its model, or σ too small"
        )
    return Verdict("consistent", ratio <= limit, ratio, limit, text)


def _bounded(bound: float, limit: float, seen: Observability) -> Verdict:
    if bound <= limit:
        return Verdict("bounded", True, bound, limit, f"attitude within {np.degrees(bound):.2g}°")
    text = "no attitude bound" if bound >= np.pi else f"attitude bound {np.degrees(bound):.0f}°"
    text += f" (limit {np.degrees(limit):.0f}°), {_remedy(seen)}"
    return Verdict("bounded", False, bound, limit, text)
