"""What sensors and clock add to an IMU-only window, as unknowns with what is known of them.

    constant bias of gyro and accelerometer      turn-on spread, or what a standstill left of it
    their scale factors                          as the sensor's specification says
    gyro noise                                   a rate for each eighth of the window, N/√Δt
    receiver clock                               a drift that walks from epoch to epoch

All enter linearly for a given rotation, and are eliminated with the start velocity: what is left
is a quadratic form in C_ew, for the same solver and the same proof. Where their product with the
rotation matters, that is in the second order, the biases found are subtracted from the IMU and
the whole is solved again, until nothing moves (Gauss–Newton).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...filters.errors import AlignmentError, ConfigError
from ...filters.rotation import FloatArray, skew
from ...filters.sensors import ImuSpec, imu_preset
from ...velocity.range_rate import DopplerNoise
from ..problem import AlignmentProblem, ClockModel, design_matrix
from ..result import AlignmentResult
from ..solver.constraints import lift
from ..solver.fast_solver import fast_minimum
from ..solver.refinement import newton, rotation_angle, tangent_basis
from ..verdict import VerdictLimits
from .rows import InertialRows

Mask = NDArray[np.bool_]

#: Change of a rotation, or rotation by a change of bias over the window, that ends the rounds.
_SETTLED = np.radians(0.01)
#: Fewest rows beyond the unknowns without a prior.
_FEWEST = 3
#: 1σ with which unknowns are held that nothing else holds [m/s]: no information, finite numbers.
_LOOSE = 1e6


@dataclass(frozen=True, eq=False)
class InertialOptions:
    """What is known of sensors and clock, and what is asked of the result.

    Parameters
    ----------
    imu : ImuSpec
        Noise and spreads of the biases.
    clock : ClockModel
        Default: a drift that walks by 0.1 m/s/√s, as that of a temperature-compensated
        oscillator in a car does.
    noise : DopplerNoise
    limits : VerdictLimits
    gyro_bias : array_like, shape (3,)
        Known beforehand, from a standstill [rad/s].
    gyro_bias_sigma : float, optional
        1σ per axis of it [rad/s]; default: the sensor's turn-on spread.
    interval : float
        Epochs closer than this are left out [s].
    segments : int
        Parts of the window in each of which the gyro noise is one rate.
    rounds : int
        Of re-linearisation at most.
    robust : bool
        Whether rows may be rejected.
    cutoff : float
        Residual, in σ of the residual, from which a row is an outlier.
    minority : float
        Share of rows beyond which rejecting them does not pass.
    """

    imu: ImuSpec = field(default_factory=lambda: imu_preset("adis16470"))
    clock: ClockModel = field(default_factory=lambda: ClockModel("random-walk", 0.1))
    noise: DopplerNoise = field(default_factory=DopplerNoise)
    limits: VerdictLimits = field(default_factory=VerdictLimits)
    gyro_bias: ArrayLike = (0.0, 0.0, 0.0)
    gyro_bias_sigma: float | None = None
    interval: float = 0.5
    segments: int = 8
    rounds: int = 6
    robust: bool = True
    cutoff: float = 3.5
    minority: float = 0.1

    def __post_init__(self) -> None:
        if not (self.segments >= 1 and self.rounds >= 1 and self.interval >= 0.0):
            raise ConfigError(
                "inertial alignment: expected segments ≥ 1, rounds ≥ 1 and interval ≥ 0 s, found "
                f"{self.segments}, {self.rounds} and {self.interval:g}"
            )
        if not (self.cutoff > 0.0 and 0.0 <= self.minority < 0.5):
            raise ConfigError(
                "inertial alignment: expected cutoff > 0 and 0 ≤ minority < ½, found "
                f"{self.cutoff:g} and {self.minority:g}"
            )
        if self.gyro_bias_sigma is not None and not 0.0 < self.gyro_bias_sigma < np.inf:
            raise ConfigError(
                f"inertial alignment: gyro_bias_sigma {self.gyro_bias_sigma!r}, expected > 0 rad/s"
            )

    @property
    def error_sigma(self) -> FloatArray:
        """1σ of biases [rad/s], [m/s²] and scale factors, gyro first, shape (12,)."""
        spec = self.imu
        gyro = float(np.hypot(spec.gyro_bias_initial_sigma, spec.gyro_bias_sigma))
        if self.gyro_bias_sigma is not None:
            gyro = self.gyro_bias_sigma
        accel = float(np.hypot(spec.accel_bias_initial_sigma, spec.accel_bias_sigma))
        sigma = [gyro, accel, 1e-6 * spec.gyro_scale_ppm, 1e-6 * spec.accel_scale_ppm]
        # A perfect sensor: far below what a window can show, and still a number to divide by.
        return np.repeat(np.maximum(sigma, [1e-9, 1e-7, 1e-8, 1e-8]), 3)


class Window:
    """Unit-variance rows over [velocity, biases, scales, gyro noise, clock; x] at given biases."""

    VELOCITY, BIASES = slice(0, 3), slice(3, 9)

    def __init__(
        self, rows: InertialRows, biases: FloatArray, prior: FloatArray, options: InertialOptions
    ) -> None:
        self.rows, self.biases, self.prior, self.options = rows, biases, prior, options
        track, n = rows.track, len(rows.track)
        parts = np.unique(np.linspace(0, n - 1, min(options.segments, n - 1) + 1).round())
        ends = parts.astype(int)
        changes = [track.response(a, b)[1] for a, b in pairwise(ends)]
        width = track.time[ends[1:]] - track.time[ends[:-1]]
        #: Response of Δv_w to biases, scale factors (gyro first) and gyro noise, (n, 3, m).
        bias, scale = slice(0, 3), slice(3, 6)
        B, F = track.B, -track.F
        self.response = np.concatenate(
            [B[:, :, bias], F[:, :, bias], B[:, :, scale], F[:, :, scale], *changes], axis=2
        )
        self.turn_sigma = np.repeat(options.imu.gyro_noise_density / np.sqrt(width), 3)
        self.clock, self.walk = _clock_unknowns(rows, options.clock)
        self.design = design_matrix(rows.rows)
        # The clock takes up any constant, here before it costs digits.
        self.level = float(np.median(rows.rows.z))
        self.design[:, 9] += self.level

    def __len__(self) -> int:
        return len(self.rows.rows)

    @property
    def unknowns(self) -> int:
        """Number of columns before x."""
        return 3 + self.response.shape[2] + self.clock.shape[1]

    def measured(self, C_ew: FloatArray) -> FloatArray:
        """Return the rows B @ [unknowns; x] ≈ 0 linearised at a rotation, shape (k, m + 10)."""
        rows = self.rows.rows
        errors = self.rows.columns(C_ew, self.response)
        stacked = np.hstack([self.rows.nuisance, errors, self.clock, self.design])
        return stacked / rows.sigma[:, None]

    def believed(self) -> FloatArray:
        """Return the rows of what is known beforehand, shape (p, m + 10)."""
        m, sensor = self.unknowns, 3 + self.response.shape[2]
        sigma = np.concatenate([self.options.error_sigma, np.maximum(self.turn_sigma, 1e-12)])
        out = np.zeros((m, m + 10))
        out[:3, :3] = np.eye(3) / _LOOSE
        out[3:sensor, 3:sensor] = np.diag(1.0 / sigma)
        # biases + δ should be the prior's.
        out[self.BIASES, -1] = (self.biases - self.prior) / sigma[:6]
        out[sensor:, sensor:m] = self.walk
        return out

    def problem(self, C_ew: FloatArray, inliers: Mask) -> AlignmentProblem:
        """Return the cost over rotations with all unknowns eliminated."""
        m, measured = self.unknowns, self.measured(C_ew)[inliers]
        rows = self.rows.rows
        triangle = np.asarray(np.linalg.qr(np.vstack([measured, self.believed()]), mode="r"))
        factor = np.zeros((10, 10))
        lower = triangle[m : m + 10, m:]
        factor[: len(lower)] = lower
        unknowns = -np.linalg.solve(triangle[:m, :m], triangle[:m, m:])
        free = 3 + int(np.sum(~np.any(self.walk, axis=0) | (np.diag(self.walk) < 2.0 / _LOOSE)))
        dof = int(np.sum(inliers)) - free - 3
        information = float(np.sum(rows.sigma[inliers] ** -2.0))
        # In the order that others have: the clock's first.
        sensor = 3 + self.response.shape[2]
        order = np.r_[sensor:m, 0:sensor]
        unknowns[sensor, 9] -= self.level
        return AlignmentProblem(factor.T @ factor, factor, dof, information, unknowns[order])


def _clock_unknowns(rows: InertialRows, clock: ClockModel) -> tuple[FloatArray, FloatArray]:
    """Return the clock's columns and the rows that hold its unknowns."""
    columns = clock.columns(rows.rows)
    held = [np.full(columns.shape[1], 1.0 / _LOOSE)]
    if clock.kind == "random-walk" and clock.q:
        time = np.unique(rows.rows.time)
        later = rows.rows.time[:, None] >= time[None, 1:]
        columns = np.hstack([columns, -1.0 * later])
        held.append(1.0 / (clock.q * np.sqrt(np.diff(time))))
    return columns, np.diag(np.concatenate(held))


@dataclass(frozen=True, eq=False)
class Solved:
    """A window at its own linearisation."""

    window: Window
    problem: AlignmentProblem
    C_ew: FloatArray
    cost: float
    rounds: int

    @property
    def biases(self) -> FloatArray:
        """Biases linearised at, with what is left to add."""
        unknowns = self._unknowns()
        return self.window.biases + unknowns[Window.BIASES]

    def _unknowns(self) -> FloatArray:
        clock = self.window.clock.shape[1]
        ordered = self.problem.nuisance_at(self.C_ew)
        return np.concatenate([ordered[clock:], ordered[:clock]])

    def joint(self, inliers: Mask) -> tuple[FloatArray, FloatArray]:
        """Return rows over [unknowns; θ] and the residuals, unit variance, measured ones first."""
        m, x = self.window.unknowns, lift(self.C_ew)
        stacked = np.vstack([self.window.measured(self.C_ew)[inliers], self.window.believed()])
        jacobian = np.hstack([stacked[:, :m], stacked[:, m : m + 9] @ tangent_basis(self.C_ew)])
        unknowns = self._unknowns()
        sensor = 3 + self.window.response.shape[2]
        # The level taken out of z is the clock's.
        unknowns[sensor] += self.window.level
        return jacobian, stacked[:, :m] @ unknowns + stacked[:, m:] @ x

    def covariance(self, inliers: Mask) -> FloatArray:
        """Return that of attitude, velocity and biases as the weights have it, e axes, (12, 12)."""
        jacobian, _ = self.joint(inliers)
        triangle = np.asarray(np.linalg.qr(jacobian, mode="r"))
        chosen = np.r_[-3:0, 0:9]
        picked = np.eye(jacobian.shape[1])[:, chosen]
        half = np.linalg.lstsq(triangle.T, picked, rcond=None)[0]
        T = np.eye(12)
        T[:3, :3] = self.C_ew
        return np.asarray(T @ half.T @ half @ T.T)

    def estimate(self, result: AlignmentResult, inliers: Mask) -> tuple[FloatArray, FloatArray]:
        """Return the velocity, and the covariance widened by what the residuals say."""
        return self._unknowns()[:3], result.inflation * self.covariance(inliers)


def settle(
    window: Callable[[FloatArray], Window], biases: FloatArray, options: InertialOptions,
    near: FloatArray | None, inliers: Mask | None = None,
) -> Solved:  # fmt: skip
    """Linearise and solve by turns: to the global minimum, or to the local one near `near`."""
    current = window(biases)
    rows = current.rows.rows
    keep = np.ones(len(current), dtype=bool) if inliers is None else inliers
    if int(np.sum(keep)) < 3 + _FEWEST:
        raise AlignmentError(f"{int(np.sum(keep))} Doppler rows are too few to align: keep waiting")
    C = _levelled(current.rows) if near is None else near
    for number in range(1, options.rounds + 1):
        problem = current.problem(C, keep)
        if near is None:
            found = fast_minimum(problem.Q).C
        else:
            found = newton(problem.Q, C, factor=problem.factor).C
        solved = Solved(current, problem, found, problem.cost(found), number)
        left = solved.biases - current.biases
        turned = np.linalg.norm(left[:3]) * (rows.time[-1] - rows.time[0])
        if number > 1 and max(turned, float(rotation_angle(C, found))) < _SETTLED:
            break
        C = found
        current = window(current.biases + left)
    return solved


def _levelled(rows: InertialRows) -> FloatArray:
    """Return a rotation that takes Δv_w to −G: right in roll and pitch, whatever the heading."""
    far = 0 if rows.track.anchor else -1
    a = rows.track.dv_w[far] / np.linalg.norm(rows.track.dv_w[far])
    b = -rows.gravity_dv[far] / np.linalg.norm(rows.gravity_dv[far])
    v, c = np.cross(a, b), float(a @ b)
    if c < -0.999999:  # half a turn, about any axis across
        axis = np.cross(a, np.eye(3)[np.argmin(np.abs(a))])
        axis /= np.linalg.norm(axis)
        return 2.0 * np.outer(axis, axis) - np.eye(3)
    return np.eye(3) + skew(v) + skew(v) @ skew(v) / (1.0 + c)
