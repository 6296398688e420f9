"""The alignment problem: from Doppler rows and local velocities to one quadratic cost.

A row says how fast the antenna moves along one line of sight,

    z = e·C_ew v_w − cδṫ + noise,            e from receiver to satellite,

where w is the local frame (the axes the local velocity is given in) and C_ew is wanted. `z` is
that of `velocity.range_rate.DopplerRows`: e·v^s − ρ̇ to first order, eq. (5) of DDIA-VE. Song et
al. write the same with n = −e; in their eqs. (4) and (7), as printed, the satellite's velocity
cancels, which their published code does not repeat.

With x = [vec(C_ew); 1] (columns stacked) a residual is linear, [v_w ⊗ e, −z]·x minus whatever is
linear in unknowns nobody asked for: the clock, a start velocity. Those are removed by projecting
the weighted rows onto the complement of their columns, which leaves f(C) = xᵀQx. Forming Q first
and eliminating by a Schur complement is the same algebra, but loses the square of the clock's
size against the residuals: 4 cm²/s² of noise for a drift of 1e6 m/s.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..filters.errors import AlignmentError, ConfigError, DataError
from ..filters.rotation import FloatArray
from .solver.constraints import lift
from .solver.elimination import eliminated

if TYPE_CHECKING:
    from ..velocity.range_rate import DopplerRows

#: 1σ per axis of a position of which nothing is said [m]: a single-point position in a street,
#: 8 mm/s of Doppler.
POSITION_SIGMA = 30.0
#: Clock models, from the stiffest to the loosest.
CLOCK_MODELS = ("constant", "linear", "random-walk", "per-epoch")


@dataclass(frozen=True, eq=False)
class AlignmentRows:
    """Doppler measurements paired with the local velocity at the same instant.

    Parameters
    ----------
    e_e : array_like, shape (k, 3)
        Line of sight from receiver to satellite, ECEF (unit vectors to 1e-3; `DopplerRows.e_e`
        carries the factor 1/κ).
    vel_w : array_like, shape (k, 3)
        Antenna velocity relative to the Earth in local axes [m/s].
    z : array_like, shape (k,)
        Measured velocity along the line of sight plus clock, z = e_e·C_ew·vel_w − cδṫ [m/s]: the
        range rate with the satellite's part taken out, positive towards the satellite.
    sigma : array_like, shape (k,)
        1σ of `z` [m/s].
    epoch : array_like of int, shape (k,)
        Index of the epoch; rows of one epoch share their clock drift.
    time : array_like, shape (k,)
        [s].
    common : array_like, shape (k, m), optional
        What 1σ of each error that all rows share does to `z` [m/s], z = … + common @ u with
        u ~ N(0, I): of the position that lines of sight were computed for, of the speed's scale.
        They are unknowns like the clock, with what is known of them. Default: none.
    """

    e_e: FloatArray
    vel_w: FloatArray
    z: FloatArray
    sigma: FloatArray
    epoch: NDArray[np.int64]
    time: FloatArray
    common: FloatArray | None = None

    def __post_init__(self) -> None:
        k = np.size(self.z)
        for name, shape in (("z", (k,)), ("e_e", (k, 3)), ("vel_w", (k, 3)), ("sigma", (k,)),
                            ("time", (k,))):  # fmt: skip
            object.__setattr__(self, name, _checked(name, getattr(self, name), shape))
        epoch = np.asarray(self.epoch)
        if epoch.shape != (k,) or (k and not np.issubdtype(epoch.dtype, np.integer)):
            raise DataError(
                f"alignment rows.epoch: expected {k} integers, "
                f"found shape {epoch.shape} of {epoch.dtype}"
            )
        object.__setattr__(self, "epoch", epoch.astype(np.int64))
        common = np.zeros((k, 0)) if self.common is None else np.asarray(self.common, dtype=float)
        shape = (k, common.shape[1] if common.ndim == 2 else 0)
        object.__setattr__(self, "common", _checked("common", common, shape))
        length = np.linalg.norm(self.e_e, axis=1)
        _refuse("e_e", np.abs(length - 1.0) > 1e-3, length, "a unit vector")
        _refuse("sigma", self.sigma <= 0.0, self.sigma, "a positive 1σ")

    def __repr__(self) -> str:
        epochs = np.unique(self.epoch).size
        return f"<AlignmentRows, {len(self)} at {epochs} epochs over {self._span:.1f} s>"

    def __len__(self) -> int:
        return self.z.size

    @property
    def _span(self) -> float:
        return float(np.ptp(self.time)) if len(self) else 0.0

    @classmethod
    def paired(
        cls,
        doppler: DopplerRows,
        time: ArrayLike,
        vel_w: ArrayLike,
        *,
        vel_sigma: float = 0.0,
        position_sigma: float = POSITION_SIGMA,
        speed_scale_sigma: float = 0.0,
    ) -> AlignmentRows:
        """Return Doppler rows paired with local velocities.

        Parameters
        ----------
        doppler : DopplerRows
            k of them.
        time : array_like, shape (k,)
            Their epochs [s].
        vel_w : array_like, shape (k, 3)
            Antenna velocity in local axes at these times [m/s].
        vel_sigma : float
            1σ per axis of it [m/s], added to that of every row.
        position_sigma : float
            1σ per axis of the position that the Doppler rows were made with [m]: three unknowns
            of the window, as far as the rows know their geometry (`DopplerRows.z_by_pos`). What
            it turns of the lines of sight themselves, 0.003° a kilometre, is left out.
        speed_scale_sigma : float
            1σ of the relative error of the velocities' scale, if it is not known; one unknown.
        """
        time, vel_w = np.asarray(time, dtype=float), np.asarray(vel_w, dtype=float)
        _, epoch = np.unique(time, return_inverse=True)
        sigma = np.hypot(doppler.sigma, vel_sigma)
        common = shared_errors(
            doppler.z, doppler.z_by_pos, position_sigma=position_sigma,
            speed_scale_sigma=speed_scale_sigma,
        )  # fmt: skip
        return cls(doppler.e_e, vel_w, doppler.z, sigma, epoch, time, common)

    @classmethod
    def of(cls, arrays: Mapping[str, ArrayLike]) -> AlignmentRows:
        """Return rows from plain arrays by their names; rows of one time are one epoch.

        Parameters
        ----------
        arrays : mapping
            'e_e', 'vel_w', 'z', 'sigma' and 'time', as above; 'epoch' and 'common' if there are.

        Raises
        ------
        DataError
            If one is missing, or there is another.
        """
        names = [field.name for field in fields(cls)]
        for name in arrays:
            if name not in names:
                raise DataError(f"alignment rows: '{name}' is none of {', '.join(names)}")
        for name in ("e_e", "vel_w", "z", "sigma", "time"):
            if name not in arrays:
                raise DataError(f"alignment rows: expected '{name}', found {', '.join(arrays)}")
        epoch = np.unique(np.asarray(arrays["time"], dtype=float), return_inverse=True)[1]
        return cls(**{"epoch": epoch, **arrays})  # type: ignore[arg-type]

    def take(self, rows: slice | NDArray) -> AlignmentRows:
        """Return the given rows (a slice, a mask or indices)."""
        return AlignmentRows(
            self.e_e[rows], self.vel_w[rows], self.z[rows], self.sigma[rows],
            self.epoch[rows], self.time[rows], self.shared[rows],
        )  # fmt: skip

    @property
    def shared(self) -> FloatArray:
        """`common`, of no columns where there is none, shape (k, m)."""
        assert self.common is not None  # __post_init__ has seen to it
        return self.common

    def reach(self, sigmas: float) -> FloatArray:
        """Return how far shared errors of so many σ move rows against their middle [m/s]."""
        apart = self.shared - self.shared.mean(axis=0)
        return np.asarray(sigmas * np.sqrt(np.sum(apart * apart, axis=1)))

    def correlated(self, count: float) -> AlignmentRows:
        """Return the rows with the σ that makes `count` of them weigh as much as one."""
        if not 1.0 <= count < np.inf:
            raise ConfigError(f"alignment rows: expected correlated ≥ 1, found {count!r}")
        return self if count == 1.0 else replace(self, sigma=self.sigma * np.sqrt(count))


def shared_errors(
    z: FloatArray, z_by_pos: FloatArray | None, *, position_sigma: float, speed_scale_sigma: float
) -> FloatArray:
    """Return what 1σ of position and speed scale do to rows [m/s], shape (k, m).

    Rows made at p + δp have z that is larger by ∂z/∂p·δp. Velocities s times too small leave
    e·C v (1 + s): s·(z − level), since e·C v is z less the clock, which takes up the level.
    """
    if not (0.0 <= position_sigma < np.inf and 0.0 <= speed_scale_sigma < np.inf):
        raise ConfigError(
            "alignment rows: expected position_sigma ≥ 0 m and speed_scale_sigma ≥ 0, found "
            f"{position_sigma!r} and {speed_scale_sigma!r}"
        )
    columns = np.zeros((z.size, 0))
    if z_by_pos is not None and position_sigma > 0.0:
        columns = position_sigma * z_by_pos
    if speed_scale_sigma > 0.0 and z.size:
        scale = speed_scale_sigma * (z - np.median(z))
        columns = np.hstack([columns, scale[:, None]])
    return columns


def _checked(name: str, value: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    array = np.asarray(value, dtype=float)
    if array.shape != shape:
        raise DataError(f"alignment rows.{name}: expected shape {shape}, found {array.shape}")
    bad = np.argwhere(~np.isfinite(array))
    if bad.size:
        raise DataError(f"alignment rows.{name}: not finite at index {int(bad[0, 0])}")
    return array


def _refuse(name: str, bad: NDArray[np.bool_], found: FloatArray, expected: str) -> None:
    if bad.any():
        k = int(np.argmax(bad))
        raise DataError(
            f"alignment rows.{name}: expected {expected}, found {found[k]:.6g} at index {k}"
        )


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
