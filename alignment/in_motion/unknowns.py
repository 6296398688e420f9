"""What sensors and clock add to an IMU-only window, as unknowns with what is known of them.

    constant bias of gyro and accelerometer      turn-on spread, or what a standstill left of it
    their scale factors                          as the sensor's specification says
    gyro noise                                   a rate for each eighth of the window, N/√Δt
    receiver clock                               a drift that walks from epoch to epoch
    position                                     an error of the σ that it comes with

`alignment.in_motion.window` solves for them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ...filters.errors import ConfigError
from ...filters.rotation import FloatArray
from ...filters.sensors import ImuSpec, imu_preset
from ...velocity.range_rate import DopplerNoise
from ..problem import ClockModel
from ..rows import POSITION_SIGMA
from ..verdict import VerdictLimits


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
    position_sigma : float
        1σ per axis of positions that come with none of their own [m].
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
    position_sigma: float = POSITION_SIGMA

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
        if not 0.0 <= self.position_sigma < np.inf:
            raise ConfigError(
                f"inertial alignment: position_sigma {self.position_sigma!r}, expected ≥ 0 m"
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
