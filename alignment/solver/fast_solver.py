"""The certified minimum without a semidefinite solver, in microseconds.

    a fixed grid of rotations → Newton from the cheapest → a Gram matrix in closed form
    → one Cholesky factorisation: certified, or the next start; last, a barrier in 15 variables

The first guess of the Gram matrix (the one nearest to zero among those that fit, see
`alignment.solver.quartic`) proves most problems with three or more satellites. Where it does not,
the multipliers are optimised, which is the relaxation of `alignment.reference.sdp` in the fourteen
unknowns that a stationary point leaves of twenty-one. The proof is about the cost matrix, however
it was found: an optimum that noise, a wrong clock or a mirror made is proved just as readily.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from types import ModuleType

import numpy as np
from numpy.typing import ArrayLike

from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray
from ..status import AlignmentStatus
from . import fast_numpy
from .constraints import multipliers_between
from .quartic import lagrangian_of

#: Gap, relative to the scale of Q, that counts as closed; rounding of a Gram matrix, likewise.
GAP, ROUNDING = 1e-9, 4e-14
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
    margin : float
        t: proved, f(R) − f(C) ≥ t (1 − cos⁴(θ/2)) up to the gap, θ the angle between R and C.
        Found on the way, not the largest; see `best_margin`.
    gram : ndarray, shape (9, 9)
        The Gram matrix that proves it; its leading 3×3 block is the Hessian.
    slope : ndarray, shape (3,)
        ∂f/∂θ of C·Exp(θ), zero to rounding.
    scale : float
        Of Q: its trace if semidefinite. What gaps are small against.
    status : AlignmentStatus
        CERTIFIED: the only optimum. AMBIGUOUS: an optimum. NOT_TIGHT: not proved.
    starts, newton_steps, barrier_steps : int
        What it took.
    """

    C: FloatArray
    cost: float
    lower_bound: float
    margin: float
    gram: FloatArray
    slope: FloatArray
    scale: float
    status: AlignmentStatus
    starts: int
    newton_steps: int
    barrier_steps: int

    def __repr__(self) -> str:
        return (
            f"<FastMinimum {self.status.name}: cost {self.cost:.6g}, relative gap {self.gap:.1e}, "
            f"t {self.best_margin:.2g}>"
        )

    @property
    def gap(self) -> float:
        """(cost − lower_bound)/scale ≥ 0."""
        return (self.cost - self.lower_bound) / self.scale

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


def fast_minimum(Q: ArrayLike, *, backend: str | None = None) -> FastMinimum:
    """Minimise xᵀQx over the rotations, x = [vec(C); 1], and prove it.

    Parameters
    ----------
    Q : array_like, shape (10, 10)
        Symmetric; need not be semidefinite.
    backend : {'numba', 'numpy'}, optional
        Default: numba where it is installed.

    Raises
    ------
    DataError
        If Q is not a finite 10×10 matrix.
    """
    scaled, scale = _scaled(Q)
    if chosen_backend(backend) == "numba":
        C, X, slope = np.empty((3, 3)), np.empty((9, 9)), np.empty(3)
        cost, t, *counts = compiled_kernels().solve(scaled, C, X, slope)
    else:
        C, cost, t, X, slope, *counts = fast_numpy.solve(scaled)
    gap = _gap(t, slope)
    if gap > GAP:
        status = AlignmentStatus.NOT_TIGHT
    else:
        status = AlignmentStatus.CERTIFIED if t > ROUNDING else AlignmentStatus.AMBIGUOUS
    return FastMinimum(
        C, cost * scale, (cost - gap) * scale, (t - ROUNDING) * scale, X * scale,
        slope * (np.sqrt(2.0) * scale), scale, status, *counts,
    )  # fmt: skip


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
    if chosen_backend(backend) == "numba":
        C, cost = np.empty((starts, 3, 3)), np.empty(starts)
        n = compiled_kernels().minima(scaled, starts, C, cost)
        order = np.argsort(cost[:n], kind="stable")
        return LocalMinima(C[:n][order], scale * cost[:n][order])
    C, cost = fast_numpy.minima(scaled, starts)
    return LocalMinima(C, scale * cost)


def _gap(t: float, slope: FloatArray) -> float:
    """Return f(C) − bound, scale 1.

    With a = |(w u, u u)|, a² = 1 − w⁴, a row of w² that is g instead of zero leaves
    t a² − 2|g| w² a: above −|g|²/t for t > 0, above t − |g| otherwise.
    """
    t -= ROUNDING
    g = float(np.sqrt(slope @ slope)) + ROUNDING
    return ROUNDING + (g * g / t if t > 0.0 else g - t)


def _scaled(Q: ArrayLike) -> tuple[FloatArray, float]:
    Q = np.asarray(Q, dtype=float)
    if Q.shape != (10, 10):
        raise DataError(f"cost matrix: expected shape (10, 10), found {Q.shape}")
    scale = max(float(np.abs(np.diagonal(Q)).sum()), float(np.sqrt(np.sum(Q * Q))), 1e-300)
    if not np.isfinite(scale):
        raise DataError("cost matrix: not finite")
    return np.ascontiguousarray(Q / scale), scale


def compiled_kernels() -> ModuleType:
    """Return the compiled module; importing numba takes half a second."""
    from . import kernels

    return kernels


def chosen_backend(name: str | None) -> str:
    """Return the backend of that name, or numba where it is installed."""
    if name is None:
        return _default_backend()
    if name not in BACKENDS:
        raise ConfigError.unknown_key(name, BACKENDS, "backend")
    return name


_DEFAULT: list[str] = []


def _default_backend() -> str:
    if not _DEFAULT:
        from ...filters.compiled.jit import COMPILED

        _DEFAULT.append("numba" if COMPILED else "numpy")
    return _DEFAULT[0]
