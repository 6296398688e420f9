"""One window: its rows and what is known beforehand, linearised and solved until it settles.

All unknowns (`alignment.in_motion.unknowns`) enter linearly for a given rotation, and are
eliminated with the start velocity: what is left is a quadratic form in C_ew, for the same solver
and the same proof. Where their product with the rotation matters, that is in the second order, the
biases found are subtracted from the IMU and the whole is solved again, until nothing moves
(Gauss–Newton).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from itertools import count

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...filters.errors import AlignmentError
from ...filters.rotation import FloatArray, skew
from ..problem import AlignmentProblem, ClockModel
from ..result import AlignmentResult
from ..solver.constraints import lift
from ..solver.fast_solver import fast_minimum
from ..solver.refinement import newton, rotation_angle, tangent_basis
from . import window_kernels as kernels
from .rows import InertialRows, antenna_velocity
from .track import ImuParts
from .unknowns import InertialOptions

Mask = NDArray[np.bool_]

#: Change of a rotation, or rotation by a change of bias over the window, that ends the rounds.
_SETTLED = np.radians(0.01)
#: Fewest rows beyond the unknowns without a prior.
_FEWEST = 3
#: 1σ with which unknowns are held that nothing else holds [m/s]: no information, finite numbers.
_LOOSE = 1e6
#: Where they stand among the unknowns.
VELOCITY, BIASES = slice(0, 3), slice(3, 9)


class Stretch:
    """What of a window does not depend on where it is linearised; `at` linearises it.

    Parameters
    ----------
    rows : InertialRows
    parts : ImuParts
    lever_b : array_like, shape (3,)
        IMU to antenna [m].
    options : InertialOptions
    """

    def __init__(
        self, rows: InertialRows, parts: ImuParts, lever_b: ArrayLike, options: InertialOptions
    ) -> None:
        self.rows, self.parts, self.options = rows, parts, options
        self.lever_b = np.asarray(lever_b, dtype=float)
        self.sigma = rows.sigma
        # The clock takes up any constant, here before it costs digits.
        self.level = float(np.median(rows.z))
        self.z = rows.z - self.level
        time, n = rows.time, rows.time.size
        parts_of_noise = min(options.segments, n - 1) + 1
        self.ends = np.unique(np.linspace(0, n - 1, parts_of_noise).round()).astype(np.int64)
        width = time[self.ends[1:]] - time[self.ends[:-1]]
        turn_sigma = np.repeat(options.imu.gyro_noise_density / np.sqrt(width), 3)
        #: 1σ of biases, scale factors and gyro noise, as the unknowns have them.
        self.error_sigma = np.concatenate([options.error_sigma, np.maximum(turn_sigma, 1e-12)])
        self.prior = np.concatenate([np.asarray(options.gyro_bias, dtype=float), np.zeros(3)])
        #: 1σ of the clock's walk between epochs, and times that go with its rate if it has one.
        self.walk, self.late = _clock(rows, options.clock)
        #: Where unknowns that rows share in their own measure stand, and how many these are.
        self.place, shared = 3 + self.error_sigma.size, rows.common.shape[1]
        #: Number of unknowns: velocity, errors of the sensors, of the position, the clock's rate
        #: if it has one.
        self.unknowns = self.place + shared + bool(self.late.size)
        self._room = np.empty((self.unknowns + 10, (4 + shared) * n + 1))
        self._last: Window | None = None

    def __len__(self) -> int:
        return len(self.rows)

    def at(self, biases: FloatArray) -> Window:
        """Return the window linearised at these biases [rad/s], [m/s²]."""
        if self._last is None or not np.array_equal(self._last.biases, biases):
            self._last = Window(self, biases)
        return self._last

    def widened(self, factor: float) -> Stretch:
        """Return the same with every σ so many times as large."""
        wider = copy(self)
        wider.sigma, wider._last = factor * self.sigma, None
        return wider

    def triangle(
        self, W: FloatArray, biases: FloatArray, inliers: Mask
    ) -> tuple[FloatArray, FloatArray]:
        """Return the triangle over [unknowns; x], and −drift at the end in terms of them."""
        size, rows = W.shape[2], self.rows
        sensor, shared = self.place, self.place + self.rows.common.shape[1]
        clock, out = np.empty(size), np.zeros((size, size))
        count = kernels.without_clock(
            rows.first, inliers, rows.e_e, self.z, self.sigma, rows.common, self.place, self.walk,
            1.0 / _LOOSE, self.late, W, self._room, clock,
        )  # fmt: skip
        # What is known beforehand, biases + δ = the prior's among it.
        np.fill_diagonal(out[: self.unknowns], 1.0 / _LOOSE)
        out[range(3, sensor), range(3, sensor)] = 1.0 / self.error_sigma
        out[range(sensor, shared), range(sensor, shared)] = 1.0
        out[BIASES, -1] = (biases - self.prior) / self.error_sigma[:6]
        kernels.fold(out, self._room, count)
        return out, clock


def _clock(rows: InertialRows, clock: ClockModel) -> tuple[FloatArray, FloatArray]:
    """Return 1σ of the walk from epoch to epoch, and the times that go with a rate."""
    interval, late = np.diff(rows.time), np.empty(0)
    if clock.kind == "per-epoch":
        return np.full(interval.size, np.inf), late
    if clock.kind == "linear":
        late = rows.time - float(np.repeat(rows.time, np.diff(rows.first)).mean())
    return (clock.q or 0.0) * np.sqrt(interval), late


class Window:
    """A stretch at given biases: what the rotation turns."""

    def __init__(self, stretch: Stretch, biases: FloatArray) -> None:
        self.stretch, self.biases = stretch, biases
        self.track = stretch.parts.track(stretch.rows.time, biases)
        self.vel_w = antenna_velocity(self.track, stretch.lever_b)
        #: Response of Δv_w to biases, scale factors (gyro first) and gyro noise, (n, 3, m).
        self.response = self.track.responses(stretch.ends)

    def __len__(self) -> int:
        return len(self.stretch)

    def columns(self, C_ew: FloatArray) -> FloatArray:
        """Return rows over [unknowns; x] before the line of sight, shape (n, 3, m + 10)."""
        m, r = self.stretch.unknowns, self.response.shape[2]
        out = np.zeros((len(self.vel_w), 3, m + 10))
        out[:, :, 3 : 3 + r] = C_ew @ self.response
        for i in range(3):
            out[:, i, i] = 1.0
            out[:, i, m + i : m + 9 : 3] = self.vel_w
        return out

    def solved(
        self, C_ew: FloatArray, inliers: Mask, near: FloatArray | None, rounds: int
    ) -> Solved:
        """Linearise at a rotation and solve: globally, or for the minimum next to `near`."""
        triangle, clock = self.stretch.triangle(self.columns(C_ew), self.biases, inliers)
        m = self.stretch.unknowns
        factor = np.ascontiguousarray(triangle[m:, m:])
        if near is None:
            found = fast_minimum(factor.T @ factor).C
        else:
            found = newton(factor.T @ factor, near, factor=factor).C
        return Solved(self, inliers, triangle, clock, C_ew, found, rounds)


@dataclass(frozen=True, eq=False)
class Solved:
    """A window at its own linearisation.

    Attributes
    ----------
    window : Window
    inliers : ndarray of bool, shape (k,)
        Rows that were used.
    triangle : ndarray, shape (m + 10, m + 10)
        Over [velocity, errors; x], linearised at `C_before`.
    clock : ndarray, shape (m + 10,)
        −drift at the last epoch in terms of the same.
    C_before, C_ew : ndarray, shape (3, 3)
        Where it was linearised, and what was found.
    rounds : int
    """

    window: Window
    inliers: Mask
    triangle: FloatArray
    clock: FloatArray
    C_before: FloatArray
    C_ew: FloatArray
    rounds: int

    @property
    def _m(self) -> int:
        return self.window.stretch.unknowns

    @cached_property
    def factor(self) -> FloatArray:
        """What is left of the triangle for x, shape (10, 10)."""
        return np.ascontiguousarray(self.triangle[self._m :, self._m :])

    @cached_property
    def cost(self) -> float:
        """χ² at `C_ew`."""
        residual = self.factor @ lift(self.C_ew)
        return float(residual @ residual)

    @cached_property
    def _others(self) -> FloatArray:
        """The unknowns as a function of x, shape (m, 10)."""
        m, inverse = self._m, np.eye(self._m)
        kernels.forward_substitute(np.ascontiguousarray(self.triangle[:m, :m]), inverse)
        return -(inverse @ self.triangle[:m, m:])

    @cached_property
    def unknowns(self) -> FloatArray:
        """Velocity, errors of the sensors and the clock's rate that go with `C_ew`, shape (m,)."""
        return np.asarray(self._others @ lift(self.C_ew))

    @property
    def biases(self) -> FloatArray:
        """Biases linearised at, with what is left to add."""
        return self.window.biases + self.unknowns[BIASES]

    @cached_property
    def problem(self) -> AlignmentProblem:
        """The cost over rotations, all unknowns eliminated; the drift at the end comes first."""
        m, stretch, kept = self._m, self.window.stretch, int(np.sum(self.inliers))
        clocks = {"per-epoch": stretch.rows.time.size, "linear": 2}
        dof = kept - 6 - clocks.get(stretch.options.clock.kind, 1)
        drift = -self.clock[m:] - self.clock[:m] @ self._others
        drift[9] -= stretch.level
        return AlignmentProblem(
            self.factor.T @ self.factor, self.factor, dof,
            float(np.sum(stretch.sigma[self.inliers] ** -2.0)), np.vstack([drift, self._others]),
        )  # fmt: skip

    @cached_property
    def _columns(self) -> FloatArray:
        return self.window.columns(self.C_ew)

    @cached_property
    def joint(self) -> FloatArray:
        """The triangle over [unknowns; θ] at `C_ew`, shape (m + 3, m + 3)."""
        m, T, window = self._m, tangent_basis(self.C_ew), self.window
        triangle, _ = window.stretch.triangle(self._columns, window.biases, self.inliers)
        out = np.zeros((m + 3, m + 3))
        out[:m, :m], out[:m, m:] = triangle[:m, :m], triangle[:m, m : m + 9] @ T
        out[m:, m:] = np.linalg.qr(triangle[m:, m : m + 9] @ T, mode="r")
        return out

    def scores(self) -> FloatArray:
        """Return |residual| of each row used in 1σ of it after the fit, shape (k,).

        Zero for the others, and for a row that nothing checks: it cannot be judged.
        """
        m, stretch, rows = self._m, self.window.stretch, self.window.stretch.rows
        found = np.append(self.unknowns, lift(self.C_ew)[:9])
        # Columns of the unknowns and of θ, and the value.
        V = np.empty((len(rows.time), 3, m + 4))
        V[:, :, :m] = self._columns[:, :, :m]
        V[:, :, m : m + 3] = self._columns[:, :, m : m + 9] @ tangent_basis(self.C_ew)
        V[:, :, m + 3] = self._columns[:, :, : m + 9] @ found
        flat = np.zeros((len(V), m + 4))
        if stretch.late.size:
            flat[:, m - 1], flat[:, m + 3] = -stretch.late, -stretch.late * found[m - 1]
        # Drifts are as the solution has them, linearised before it turned.
        before = self.window.columns(self.C_before)[:, :, : m + 9] @ found
        at, q = stretch.place, rows.common.shape[1]
        own = rows.common @ found[at : at + q]
        clock = np.sum(rows.e_e * before[rows.epoch], axis=1) + flat[rows.epoch, m + 3] + own
        # A clock that does not walk, by a ten-thousandth of what a row resolves.
        walk = np.maximum(stretch.walk, 1e-4 * stretch.sigma.min())
        out = np.empty(len(stretch))
        kernels.scores(
            rows.first, self.inliers, rows.e_e, stretch.z, stretch.sigma, rows.common, at, walk,
            1.0 / _LOOSE, V, flat, own, clock, self.joint, out,
        )  # fmt: skip
        return out

    @cached_property
    def covariance(self) -> FloatArray:
        """That of attitude, velocity and biases as the weights have it, e axes, (12, 12)."""
        size = len(self.joint)
        half = np.zeros((12, size))
        half[np.arange(12), np.r_[size - 3 : size, 0:9]] = 1.0
        kernels.forward_substitute(self.joint, half)
        T = np.eye(12)
        T[:3, :3] = self.C_ew
        return np.asarray(T @ (half @ half.T) @ T.T)

    def estimate(self, result: AlignmentResult) -> tuple[FloatArray, FloatArray]:
        """Return the velocity, and the covariance widened by what the residuals say."""
        return self.unknowns[VELOCITY], result.inflation * self.covariance


def linearisations(
    window: Callable[[FloatArray], Window], biases: FloatArray, options: InertialOptions,
    near: FloatArray | None, inliers: Mask | None = None,
) -> Iterator[Solved]:  # fmt: skip
    """Linearise and solve by turns: to the global minimum, or to the local one near `near`.

    The last that is yielded is settled, or `InertialOptions.rounds` have passed.
    """
    current = window(biases)
    time = current.track.time
    keep = np.ones(len(current), dtype=bool) if inliers is None else inliers
    if int(np.sum(keep)) < 3 + _FEWEST:
        raise AlignmentError(f"{int(np.sum(keep))} Doppler rows are too few to align: keep waiting")
    C = _levelled(current) if near is None else near
    for number in count(1):
        solved = current.solved(C, keep, None if near is None else C, number)
        yield solved
        left = solved.unknowns[BIASES][:3]
        turned = float(np.sqrt(left @ left) * (time[-1] - time[0]))
        moved = max(turned, float(rotation_angle(C, solved.C_ew)))
        if number == options.rounds or (number > 1 and moved < _SETTLED):
            return
        C, current = solved.C_ew, window(solved.biases)


def settle(
    window: Callable[[FloatArray], Window], biases: FloatArray, options: InertialOptions,
    near: FloatArray | None, inliers: Mask | None = None,
) -> Solved:  # fmt: skip
    """Return the last of `linearisations`."""
    return deque(linearisations(window, biases, options, near, inliers), maxlen=1)[0]


def _levelled(window: Window) -> FloatArray:
    """Return a rotation that takes Δv_w to −G: right in roll and pitch, whatever the heading."""
    dv_w, gravity_dv = window.track.dv_w[0], window.stretch.rows.gravity_dv[0]
    a, b = dv_w / np.linalg.norm(dv_w), -gravity_dv / np.linalg.norm(gravity_dv)
    v, c = np.cross(a, b), float(a @ b)
    if c < -0.999999:  # half a turn, about any axis across
        axis = np.cross(a, np.eye(3)[np.argmin(np.abs(a))])
        axis /= np.linalg.norm(axis)
        return 2.0 * np.outer(axis, axis) - np.eye(3)
    return np.eye(3) + skew(v) + skew(v) @ skew(v) / (1.0 + c)
