"""The alignment problem: from rows of Doppler and local velocity to one quadratic cost.

With x = [vec(C_ew); 1] (columns stacked) a row's residual is linear, [v_w ⊗ e, −z]·x minus
whatever is linear in unknowns nobody asked for: the clock, a start velocity. Those are removed by
projecting the weighted rows onto the complement of their columns, which leaves f(C) = xᵀQx.
Forming Q first and eliminating by a Schur complement is the same algebra, but loses the square of
the clock's size against the residuals: 4 cm²/s² of noise for a drift of 1e6 m/s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..filters.errors import AlignmentError, ConfigError, DataError
from ..filters.rotation import FloatArray
from .rows import AlignmentRows
from .solver.constraints import lift
from .solver.elimination import eliminated

#: Clock models, from the stiffest to the loosest.
CLOCK_MODELS = ("constant", "linear", "random-walk", "per-epoch")


@dataclass(frozen=True)
class ClockModel:
    """What is known of the receiver's clock drift within a window.

    Parameters
    ----------
    kind : {'constant', 'linear', 'random-walk', 'per-epoch'}
        One drift for the window (the paper's), a drift and its rate, a drift that wanders, or a
        free drift at every epoch. 'random-walk' contains the outer two as limits and is never
        worse than they are.
    q : float, optional
        Of the random walk only, and required by it: growth of the drift [m/s/√s].

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import ClockModel, align
    >>> from certnav.alignment.reference import simulate_window
    >>> rng = np.random.default_rng(7)
    >>> window = simulate_window(rng, 4, "3d", epochs=20, speed=10.0, sigma=0.05, clock_rate=0.3)
    >>> align(window.rows).passed, align(window.rows, ClockModel("linear")).passed
    (False, True)
    """

    kind: str = "constant"
    q: float | None = None

    def __post_init__(self) -> None:
        if self.kind not in CLOCK_MODELS:
            raise ConfigError.unknown_key(self.kind, CLOCK_MODELS, "clock model")
        if self.kind == "random-walk" and not (self.q is not None and 0.0 <= self.q < np.inf):
            raise ConfigError(
                f"clock model 'random-walk': expected q ≥ 0 in m/s/√s, found {self.q!r}"
            )
        if self.kind != "random-walk" and self.q is not None:
            raise ConfigError(f"clock model '{self.kind}' has no q — did you mean 'random-walk'?")

    def columns(self, rows: AlignmentRows) -> FloatArray:
        """Return the columns of the clock unknowns [drift, rate …], shape (k, m)."""
        if self.kind == "per-epoch":
            _, which = np.unique(rows.epoch, return_inverse=True)
            return -np.eye(which.max(initial=-1) + 1)[which]
        ones = -np.ones((len(rows), 1))
        if self.kind == "linear":
            return np.hstack([ones, ones * (rows.time - rows.time.mean())[:, None]])
        return ones

    def drifts(self, rows: AlignmentRows) -> int:
        """Return how many of `columns`, from the first, are drifts; the others are rates."""
        return np.unique(rows.epoch).size if self.kind == "per-epoch" else 1

    def whiten(self, rows: AlignmentRows, matrix: FloatArray) -> FloatArray:
        """Return `matrix` with its rows decorrelated and scaled to unit variance.

        The random walk's start is the unknown of `columns`; what it adds since the first row is
        noise of covariance q²·min(tᵢ, tⱼ).
        """
        if self.kind != "random-walk" or not self.q:
            return matrix / rows.sigma[:, None]
        from .clock_walk import independent  # numba is slow to import: left until it is used

        return independent(np.ascontiguousarray(matrix), rows.sigma, rows.time, self.q)


@dataclass(frozen=True, eq=False)
class AlignmentProblem:
    """f(C) = xᵀQx, x = [vec(C_ew); 1]: the sum of squared normalised residuals.

    Attributes
    ----------
    Q : ndarray, shape (10, 10)
        Cost matrix, symmetric.
    factor : ndarray, shape (10, 10)
        Upper triangular with ``factor.T @ factor == Q``; residuals near zero keep the digits
        that squaring drops.
    dof : int
        Degrees of freedom of the cost at its minimum: rows − nuisances − 3.
    information : float
        Σ 1/σ² over the rows [s²/m²].
    nuisance : ndarray, shape (m, 10)
        Nuisance parameters as a function of x: the clock's first, cδṫ [m/s]; last, in units of
        their σ, those that `AlignmentRows.common` is about.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import build_problem
    >>> from certnav.alignment.reference import simulate_window
    >>> rng = np.random.default_rng(7)
    >>> window = simulate_window(rng, 4, "3d", epochs=20, speed=10.0, sigma=0.05)
    >>> problem = build_problem(window.rows)
    >>> bool(problem.cost(window.C_ew) < 2.0 * problem.dof)  # the truth fits
    True
    >>> bool(problem.cost(np.eye(3)) < 2.0 * problem.dof)
    False
    >>> problem.nuisance_at(window.C_ew).shape  # cδṫ [m/s]
    (1,)
    """

    Q: FloatArray
    factor: FloatArray
    dof: int
    information: float
    nuisance: FloatArray

    def __repr__(self) -> str:
        return f"<AlignmentProblem, {self.dof} dof, {len(self.nuisance)} nuisances eliminated>"

    def cost(self, C_ew: ArrayLike) -> float:
        """Return f(C_ew), χ²-distributed with `dof` + 3 degrees of freedom at the truth."""
        residuals = self.factor @ lift(C_ew)
        return float(residuals @ residuals)

    def nuisance_at(self, C_ew: ArrayLike) -> FloatArray:
        """Return the clock and other nuisance parameters that go with a rotation, shape (m,)."""
        return self.nuisance @ lift(C_ew)


def design_matrix(rows: AlignmentRows) -> FloatArray:
    """Return B with ``B @ x == e·C_ew v_w − z``, the residual before the clock, shape (k, 10)."""
    outer = rows.vel_w[:, :, None] * rows.e_e[:, None, :]
    return np.hstack([outer.reshape(len(rows), 9), -rows.z[:, None]])


def build_problem(
    rows: AlignmentRows,
    clock: ClockModel | None = None,
    nuisance: ArrayLike | None = None,
    *,
    correlated: float = 1.0,
) -> AlignmentProblem:
    """Return the cost over rotations with clock and nuisances eliminated.

    Parameters
    ----------
    rows : AlignmentRows
    clock : ClockModel, optional
        Default: constant over the window.
    nuisance : array_like, shape (k, m), optional
        Further unknowns that enter the rows linearly, z = … + nuisance @ parameters; a constant
        velocity unknown in e axes has the columns `rows.e_e`.
    correlated : float
        How many successive rows of a satellite say what one independent row would: 1 + 2Σρ of
        their errors (`velocity.doppler_noise.correlated_epochs`). Cost and degrees of freedom are
        those of so many times fewer rows.

    Raises
    ------
    AlignmentError
        If there are no rows, or nothing about the rotation is left after the elimination.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import build_problem
    >>> from certnav.alignment.reference import simulate_window
    >>> rng = np.random.default_rng(7)
    >>> window = simulate_window(rng, 4, "3d", epochs=20, speed=10.0, sigma=0.05)
    >>> problem = build_problem(window.rows)
    >>> problem.Q.shape, problem.dof  # 80 rows less a clock drift and three angles
    ((10, 10), 76)
    """
    clock = clock or ClockModel()
    k = len(rows)
    rows = rows.correlated(correlated)
    if not k:
        raise AlignmentError("no rows to align with: no Doppler and local velocity at one time")
    extra = np.zeros((k, 0)) if nuisance is None else np.asarray(nuisance, dtype=float)
    if extra.ndim != 2 or extra.shape[0] != k:
        raise DataError(f"nuisance: expected shape ({k}, m), found {extra.shape}")
    # What is shared stands last, with a row of its own that says how large it may be.
    columns = [clock.columns(rows), extra, rows.shared]
    # Every model has a constant drift among its columns. What is taken off first costs no digits.
    level = float(np.median(rows.z))
    design = design_matrix(rows)
    design[:, 9] += level
    stack = clock.whiten(rows, np.hstack([*columns, design]))
    m, shared = stack.shape[1] - 10, rows.shared.shape[1]
    if shared:
        stack = np.vstack([stack, np.eye(shared, m + 10, m - shared)])
    parameters, factor, rank = eliminated(stack, m)
    if np.linalg.norm(factor[:, :9]) <= 1e-12 * float(np.linalg.norm(stack[:, m:])):
        raise AlignmentError(
            "the rows say nothing about the attitude: the vehicle stands still, or the clock "
            "model takes up every row — wait for motion, or use a stiffer clock model"
        )
    parameters[: clock.drifts(rows), 9] -= level
    return AlignmentProblem(
        factor.T @ factor, factor, int(k / correlated) + shared - rank - 3,
        float(np.sum(rows.sigma**-2.0)), parameters,
    )  # fmt: skip
