"""The certified minimum without a semidefinite solver, in microseconds.

    a fixed grid of rotations → Newton from the cheapest → a Gram matrix in closed form
    → one Cholesky factorisation: certified, or the next start; last, a barrier in 15 variables

The first guess of the Gram matrix (the one nearest to zero among those that fit, see
`alignment.solver.quartic`) proves most problems with three or more satellites. Where it does not,
the multipliers are optimised, which is the relaxation of `alignment.reference.sdp` in the fourteen
unknowns that a stationary point leaves of twenty-one. The proof is about the cost matrix, however
it was found: an optimum that noise, a wrong clock or a mirror made is proved just as readily.

Rounding is part of the proof (`alignment.status.Growth`). Where it hides what is asked, one window
in thousands, `alignment.solver.exact_cost` answers in integers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray
from ..status import GAP, REGION, RELATIVE_GAP, AlignmentStatus, Growth
from . import fast_numpy
from .constraints import lift, multipliers_between
from .exact_cost import ExactCost, integer_quaternion, proves, rotation_of
from .quartic import gram, lagrangian_of

#: Rounding of a Gram matrix and of its slope, relative to the scale of Q: two products of ten
#: terms, 26 half-ulps in all, times the norm of |T|, 5.3 (T the matrix from monomials to x), twice:
#: 8e-14; twice that for Q itself, for C that is a rotation to 3e-16 only, and for the Cholesky
#: factorisation. Seen are 1e-15.
ROUNDING = 2e-13
#: The barrier maximises t to 1e-13. Below the first of these a margin is zero; from the second on
#: it may be proved in integers. What lies between cannot depend on who found the rotation.
ZERO, LEAST = 5e-13, 1e-12
#: Slope over margin [rad] from which a rotation is brought nearer before integers refine it.
NEAR = 1e-3
#: Rounding of residuals in the factor of a cost, relative to √scale: a backward stable reduction.
REDUCTION = 1e-14
_SQRT2 = math.sqrt(2.0)
#: Ways to compute it; they agree.
BACKENDS = ("numba", "numpy")


@dataclass(frozen=True, eq=False)
class FastMinimum:
    """A minimum of f(C) = xᵀQx over the rotations, with the proof of it.

    Attributes
    ----------
    C : ndarray, shape (3, 3)
    cost : float
        f(C).
    lower_bound : float
        Proved: no rotation costs less. Rounding is allowed for.
    gap : float
        Proved: no rotation costs less than this one by more. Less than `cost` − `lower_bound`,
        in which the cost itself is rounded.
    margin : float
        t: proved, f(R) − f(C) ≥ t (1 − cos⁴(θ/2)) up to the gap, θ the angle between R and C.
        Found on the way, not the largest; see `best_margin`.
    region : float
        Proved: every rotation that costs less is within this angle [rad]; π if nothing is.
    gram : ndarray, shape (9, 9)
        The Gram matrix that proves it; its leading 3×3 block is the Hessian.
    slope : ndarray, shape (3,)
        ∂f/∂θ of C·Exp(θ), zero to rounding.
    scale : float
        Of Q: its trace if semidefinite. What gaps are small against.
    status : AlignmentStatus
        As `alignment.status.Growth` has it.
    starts, newton_steps, barrier_steps : int
        What it took.
    """

    C: FloatArray
    cost: float
    lower_bound: float
    gap: float
    margin: float
    region: float
    gram: FloatArray
    slope: FloatArray
    scale: float
    status: AlignmentStatus
    starts: int
    newton_steps: int
    barrier_steps: int

    def __repr__(self) -> str:
        return (
            f"<FastMinimum {self.status.name}: cost {self.cost:.6g}, gap {self.gap:.1e}, "
            f"t {self.best_margin:.2g}>"
        )

    @property
    def hessian(self) -> FloatArray:
        """∂²f/∂θ² of C·Exp(θ), shape (3, 3), w axes."""
        return self.gram[:3, :3]

    @cached_property
    def uniqueness(self) -> float:
        """The t that the Gram matrix at hand proves: its smallest eigenvalue, rounded down."""
        return float(np.linalg.eigvalsh(self.gram)[0]) - ROUNDING * self.scale

    @property
    def best_margin(self) -> float:
        """The largest t at hand; not positive: other rotations may cost as little."""
        return self.margin if self.margin <= 0.0 else max(self.margin, self.uniqueness)

    def covariance(self) -> FloatArray:
        """Return the covariance of θ, C_true = C·Exp(θ) [rad²], w axes, if f is χ².

        Along directions in which f is flat to rounding it is very large instead of infinite.
        """
        values, axes = np.linalg.eigh(0.5 * self.hessian)
        return (axes / np.maximum(values, ROUNDING * self.scale)) @ axes.T

    def multipliers(self, Q: ArrayLike) -> FloatArray:
        """Return the λₖ of all constraints, for `alignment.proofs.certificate` and exact proofs.

        Parameters
        ----------
        Q : array_like, shape (10, 10)
            The matrix that was minimised.
        """
        return multipliers_between(Q, lagrangian_of(self.gram, self.C))


def fast_minimum(
    Q: ArrayLike, *, factor: ArrayLike | None = None, backend: str | None = None
) -> FastMinimum:
    """Minimise xᵀQx over the rotations, x = [vec(C); 1], and prove it.

    Parameters
    ----------
    Q : array_like, shape (10, 10)
        Symmetric; need not be semidefinite. In χ² units: `alignment.status.GAP` is.
    factor : array_like, shape (10, 10), optional
        With factorᵀ·factor = Q. Where rounding matters it is believed instead of Q.
    backend : {'numba', 'numpy'}, optional
        Default: numba where it is installed.

    Raises
    ------
    DataError
        If Q is not a finite 10×10 matrix.
    """
    scaled, scale = _scaled(Q)
    C, cost, t, X, slope, *counts = chosen_backend(backend).solve(scaled)
    found = _Found(C, cost, t, X, slope, counts)
    return _proved(found, _Task(Q, scaled, scale, factor, backend))


def proved_at(Q: ArrayLike, C: ArrayLike, *, factor: ArrayLike | None = None) -> FastMinimum:
    """Return the minimum in whose basin C lies, proved as `fast_minimum` proves its own.

    Parameters
    ----------
    Q, factor
        As for `fast_minimum`.
    C : array_like, shape (3, 3)
        A rotation, however found.
    """
    scaled, scale = _scaled(Q)
    task = _Task(Q, scaled, scale, factor, None)
    return _proved(_margin_at(task, *fast_numpy.descend(scaled, np.asarray(C, dtype=float))), task)


class _Task(NamedTuple):
    """A cost: as given, and with scale 1."""

    Q: ArrayLike
    scaled: FloatArray
    scale: float
    factor: ArrayLike | None
    backend: str | None


class _Found(NamedTuple):
    """What a backend hands over, scale 1."""

    C: FloatArray
    cost: float
    t: float
    X: FloatArray
    slope: FloatArray
    counts: list[int]


def _margin_at(task: _Task, C: FloatArray, steps: int = 0) -> _Found:
    """Return the Gram matrix and the margin of a rotation at the bottom of its basin."""
    X, slope = fast_numpy.smallest_gram(gram(task.scaled, C))
    t, barriers = fast_numpy.quick_margin(X), 0
    if not t > 0.0:
        largest_margin = chosen_backend(task.backend).largest_margin
        t, X, barriers = largest_margin(X, fast_numpy.ENOUGH, -2.0 * RELATIVE_GAP)
    return _Found(C, _cost(task.scaled, C), t, X, slope, [1, steps, barriers])


def _proved(found: _Found, task: _Task) -> FastMinimum:
    growth = _growth(found, task.scale)
    if growth.status is not AlignmentStatus.CERTIFIED:
        return _proved_slowly(found, growth, task)
    cost = found.cost * task.scale
    return _handed_over(found, growth, cost, cost - ROUNDING * task.scale)


def _proved_slowly(found: _Found, growth: Growth, task: _Task) -> FastMinimum:
    """Return what a longer search, or integers, make of a rotation that is not certified."""
    scale = task.scale
    for search in (fast_numpy.own_bottom, fast_numpy.low_bottoms):
        short = growth.slope > 2.0 * ROUNDING * scale or found.t < -ZERO
        if growth.status is AlignmentStatus.CERTIFIED or not short:
            break
        # Short of the end of a narrow valley, or in the higher of two wells.
        C = min(search(task.scaled, found.C), key=lambda C: _cost(task.scaled, C))
        found = _margin_at(task, C)._replace(counts=found.counts)
        growth = _growth(found, scale)
    if growth.status is not AlignmentStatus.CERTIFIED and found.t > ZERO:
        closely = _closely(found, task)
        if closely is not None:
            found, growth, cost = closely
            return _handed_over(found, growth, cost, cost)
    cost = found.cost * scale
    return _handed_over(found, growth, cost, cost - ROUNDING * scale)


def _handed_over(found: _Found, growth: Growth, cost: float, least: float) -> FastMinimum:
    """Return the minimum; `least` is its cost with rounding taken against us."""
    gap, scale = growth.gap, growth.scale
    return FastMinimum(
        found.C, cost, least - gap, gap, growth.margin, growth.region, found.X * scale,
        found.slope * (_SQRT2 * scale), scale, growth.status, *found.counts,
    )  # fmt: skip


def _cost(scaled: FloatArray, C: FloatArray) -> float:
    x = lift(C)
    return float(x @ scaled @ x)


def _growth(found: _Found, scale: float) -> Growth:
    """Return what floating point proves, rounding taken against us."""
    slope = math.sqrt(found.slope @ found.slope) + ROUNDING
    # A margin that is zero is so for every backend, whatever its last digits.
    t = found.t - ROUNDING if abs(found.t) > ZERO else -ZERO
    return Growth(t * scale, slope * scale, scale)


def _closely(found: _Found, task: _Task) -> tuple[_Found, Growth, float] | None:
    """Return what integers prove; None if the margin is too small for that too.

    They start from a rotation that is the same to the last digit however it was found.
    """
    scale, exact = task.scale, ExactCost.of(task.Q, task.factor)
    if math.sqrt(found.slope @ found.slope) > NEAR * found.t:
        (C,) = fast_numpy.own_bottom(task.scaled, found.C)
        found = found._replace(C=C)
    q = exact.refined(integer_quaternion(found.C))
    found = _margin_at(task, rotation_of(q))._replace(counts=found.counts)
    if found.t < LEAST:
        return None
    cost, margin = float(exact.value(q)), 0.5 * found.t * scale
    # What a proof in integers leaves open is to be nothing beside what is called closed.
    offset = min(0.01 * GAP, 0.001 * REGION**2 * margin)
    if not proves(exact, q, scale * found.X, margin, offset):
        return None
    # A factor came from rows: what its rounding does to residuals r is 2|r|·REDUCTION·√scale.
    slope = 0.0
    if task.factor is not None:
        slope = 2.0 * REDUCTION * math.sqrt(max(cost, 0.0) * scale)
    return found, Growth(margin - slope, slope, scale, offset), cost


@dataclass(frozen=True, eq=False)
class LocalMinima:
    """Minima of one cost, the lowest first.

    Attributes
    ----------
    C : ndarray, shape (n, 3, 3)
    cost : ndarray, shape (n,)
    """

    C: FloatArray
    cost: FloatArray

    def __repr__(self) -> str:
        costs = ", ".join(f"{cost:.4g}" for cost in self.cost[:4])
        more = ", …" if len(self.cost) > 4 else ""
        return f"<LocalMinima, {len(self.cost)} of cost [{costs}{more}]>"


def local_minima(Q: ArrayLike, *, starts: int = 24, backend: str | None = None) -> LocalMinima:
    """Return the minima reached from a grid; there is no promise that these are all.

    Parameters
    ----------
    Q : array_like, shape (10, 10)
    starts : int
        At most; the grid holds about 24 that are 60° apart.
    backend : {'numba', 'numpy'}, optional
    """
    scaled, scale = _scaled(Q)
    C, cost = chosen_backend(backend).minima(scaled, starts)
    return LocalMinima(C, scale * cost)


def _scaled(Q: ArrayLike) -> tuple[FloatArray, float]:
    Q = np.asarray(Q, dtype=float)
    if Q.shape != (10, 10):
        raise DataError(f"cost matrix: expected shape (10, 10), found {Q.shape}")
    scale = max(float(np.abs(np.diagonal(Q)).sum()), float(np.sqrt(np.sum(Q * Q))), 1e-300)
    if not np.isfinite(scale):
        raise DataError("cost matrix: not finite")
    return np.ascontiguousarray(Q / scale), scale


def chosen_backend(name: str | None) -> ModuleType:
    """Return the module that computes it: that of the name, or numba's where it is installed."""
    if name is not None and name not in BACKENDS:
        raise ConfigError.unknown_key(name, BACKENDS, "backend")
    if not _MODULES:
        from ...filters.compiled.jit import COMPILED

        _MODULES["numpy"] = fast_numpy
        _MODULES[""] = _compiled() if COMPILED else fast_numpy
    if name == "numba" and name not in _MODULES:
        _MODULES[name] = _compiled()
    return _MODULES[name or ""]


#: Backends by name, '' the default; importing numba takes half a second.
_MODULES: dict[str, ModuleType] = {}


def _compiled() -> ModuleType:
    from . import fast_compiled

    return fast_compiled
