"""What may be believed of an alignment: five verdicts kept apart, and one that needs them all.

    optimal      the rotation is proved to have the lowest cost          (gap in χ²)
    unique       and no other rotation has the same                      (region of what costs less)
    unambiguous  nor one that noise could have preferred                 (runner-up within χ²)
    consistent   the rows agree with each other and with their weights   (χ² per degree of freedom)
    bounded      every rotation within the χ² region is near             (certified attitude bound)

The first two are proofs about a matrix and say nothing about the world: with a wrong clock model,
a mirrored geometry or clustered outliers the certified optimum is wrong by tens of degrees. Only a
result that passes all five may start a filter.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaincinv

from ..filters.errors import ConfigError
from .observability import Observability, observability
from .priors import Prior, with_priors
from .problem import AlignmentProblem, ClockModel, build_problem
from .result import AlignmentResult, Ask, Verdict, inflation
from .rows import AlignmentRows
from .solver.attitude_bound import attitude_bound, region_threshold
from .solver.fast_solver import LocalMinima, fast_minimum, local_minima
from .solver.refinement import rotation_angle
from .status import GAP, REGION, AlignmentStatus, ProvedMinimum


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

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import VerdictLimits, align
    >>> from certnav.alignment.reference import simulate_window
    >>> rng = np.random.default_rng(7)
    >>> window = simulate_window(rng, 4, "3d", epochs=20, speed=10.0, sigma=0.05)
    >>> align(window.rows, limits=VerdictLimits(bound=np.radians(0.1))).passed
    False
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


def align(
    rows: AlignmentRows,
    clock: ClockModel | None = None,
    *,
    nuisance: ArrayLike | None = None,
    priors: Iterable[Prior] = (),
    correlated: float = 1.0,
    limits: VerdictLimits | None = None,
    vel_sigma: float = 0.0,
    backend: str | None = None,
) -> AlignmentResult:
    """Find the attitude of the local frame from Doppler rows with local velocities, and judge it.

    Every row is believed; `alignment.robust.align_robust` finds out which may be, and
    `alignment.entrance.align` takes plain arrays, too.

    Parameters
    ----------
    rows : AlignmentRows
        `AlignmentRows.paired` makes them of Doppler and local velocities, with the position's σ.
    clock : ClockModel, optional
        Default: one drift for the whole window.
    nuisance : array_like, shape (k, m), optional
        Further unknowns, as for `alignment.problem.build_problem`.
    priors : iterable of Prior
        What else is known of the attitude.
    correlated : float
        How many rows say what one independent row would, as for `build_problem`.
    limits : VerdictLimits, optional
    vel_sigma : float
        1σ per axis of the local velocities [m/s], for the observability test.
    backend : {'numba', 'numpy'}, optional
        Of the solver.

    Raises
    ------
    AlignmentError
        If there are no rows, or they say nothing about the attitude.
    """
    problem = build_problem(rows, clock, nuisance, correlated=correlated)
    problem = with_priors(problem, priors)
    return judge(problem, limits=limits, vel_sigma=vel_sigma, backend=backend)


def judge(
    problem: AlignmentProblem,
    *,
    limits: VerdictLimits | None = None,
    vel_sigma: float = 0.0,
    backend: str | None = None,
) -> AlignmentResult:
    """Solve a problem whose cost is χ² and judge the solution; the second half of `align`.

    Parameters
    ----------
    problem : AlignmentProblem
        Its rows weighted with their σ.
    limits, vel_sigma, backend
        As for `align`.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import build_problem, judge
    >>> from certnav.alignment.reference import simulate_window
    >>> rng = np.random.default_rng(7)
    >>> window = simulate_window(rng, 4, "3d", epochs=20, speed=10.0, sigma=0.05)
    >>> judge(build_problem(window.rows)).passed  # what align does with plain rows
    True
    """
    limits = limits or VerdictLimits()
    Q = problem.Q
    minimum = fast_minimum(Q, factor=problem.factor, backend=backend)
    seen = observability(Q, vel_sigma=vel_sigma, information=problem.information)
    rivals = _others(minimum, local_minima(Q, backend=backend))
    cost = problem.cost(minimum.C)
    # Weights that are too optimistic make the region too small.
    wider = inflation(cost, problem.dof)
    threshold = wider * region_threshold(limits.probability)
    bound = attitude_bound(minimum, threshold, backend=backend)
    verdicts = (
        optimal(minimum), unique(minimum, seen),
        _unambiguous(minimum, rivals, wider * limits.ambiguity),
        _consistent(cost, problem.dof, limits), _bounded(bound, limits.bound, seen),
    )  # fmt: skip
    return AlignmentResult(
        minimum.C, wider * minimum.covariance(), bound, verdicts, cost, problem.dof,
        problem.nuisance_at(minimum.C), minimum, rivals, seen, problem,
    )  # fmt: skip


def _others(minimum: ProvedMinimum, found: LocalMinima) -> LocalMinima:
    """Return the minima that are not the one at hand (0.6° counts as the same)."""
    other = rotation_angle(minimum.C, found.C) > 0.01
    return LocalMinima(found.C[other], found.cost[other])


def optimal(minimum: ProvedMinimum) -> Verdict:
    """Return whether the minimum is proved to be the lowest."""
    passed = minimum.status.optimal
    text = f"optimum {'proved' if passed else 'not proved'}, gap χ² {minimum.gap:.1e}"
    return Verdict(Ask.OPTIMAL, passed, minimum.gap, GAP, text)


def unique(minimum: ProvedMinimum, seen: Observability) -> Verdict:
    """Return whether it is the only one, and the geometry bears that out."""
    region, determined = minimum.region, seen.geometry.determined
    passed = minimum.status is AlignmentStatus.CERTIFIED and determined
    if passed:
        text = f"the only optimum: what costs less is within {np.degrees(region):.1g}°"
    elif determined:
        text = f"other rotations may cost as little, t = {minimum.best_margin:.2g}"
    else:
        text = (
            f"{seen.geometry.value}; velocities span {seen.rank_v}, lines of sight "
            f"{seen.rank_n} dimensions — {_remedy(seen)}"
        )
    return Verdict(Ask.UNIQUE, passed, region, REGION, text)


def _remedy(seen: Observability) -> str:
    if seen.rank_v < 2:
        return "needs a turn or a change of speed"
    if seen.rank_n < 2:
        return "needs more satellites or a steadier clock model"
    if seen.rank_v == seen.rank_n == 2:
        return "needs a third satellite, a slope or an up prior"
    return "needs a turn, a change of speed or more satellites"


def _unambiguous(minimum: ProvedMinimum, rivals: LocalMinima, limit: float) -> Verdict:
    excess = rivals.cost - minimum.cost
    near = int(np.sum(excess < limit))
    value = float(excess[0]) if len(excess) else np.inf
    if not near:
        text = f"runner-up at χ² +{value:.3g}" if len(excess) else "no other minimum found"
        return Verdict(Ask.UNAMBIGUOUS, True, value, limit, text)
    angle = np.degrees(rotation_angle(minimum.C, rivals.C[0]))
    text = (
        f"{near} other minima within χ² +{limit:.0f}, the next at +{max(value, 0.0):.2g}, "
        f"{angle:.0f}° away"
    )
    return Verdict(Ask.UNAMBIGUOUS, False, value, limit, text)


def _consistent(cost: float, dof: int, limits: VerdictLimits) -> Verdict:
    if dof < limits.redundancy:
        text = f"{dof} redundant rows, {limits.redundancy} are needed to notice an error"
        return Verdict(Ask.CONSISTENT, False, np.inf, 0.0, text)
    limit = float(2.0 * gammaincinv(0.5 * dof, limits.consistency)) / dof  # the quantile of χ²
    ratio = cost / dof
    text = f"χ²/dof {ratio:.2f} at {dof}"
    if ratio > limit:
        text += (
            f" (limit {limit:.2f}): outliers, a clock less steady than its model, or σ too small"
        )
    return Verdict(Ask.CONSISTENT, ratio <= limit, ratio, limit, text)


def _bounded(bound: float, limit: float, seen: Observability) -> Verdict:
    if bound <= limit:
        return Verdict(Ask.BOUNDED, True, bound, limit, f"attitude within {np.degrees(bound):.2g}°")
    text = "no attitude bound" if bound >= np.pi else f"attitude bound {np.degrees(bound):.0f}°"
    text += f" (limit {np.degrees(limit):.0f}°), {_remedy(seen)}"
    return Verdict(Ask.BOUNDED, False, bound, limit, text)
