"""Error states of the ECEF mechanisation: their order, their dynamics, their noise.

Errors are true − estimated; the attitude error φ is a small rotation in e axes:

    C_eb(true) = (I + [φ×]) C_eb(estimated),    bias(true) = bias + δb

    δp' = δv
    δv' = −[f_e×]φ − 2[ω_ie×]δv + (∂g/∂p)δp − C_eb δf
    φ'  = −[ω_ie×]φ − C_eb δω

with δf = δb_a + diag(f)δs_a and δω = δb_g + diag(ω)δs_g, each over one plus its scale factor
(Groves 2013, section 14.2.3, with the signs of the definitions above). Biases are first-order
Gauss–Markov processes, or random walks when their correlation time is infinite.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from filters import _kernels
from filters.errors import ConfigError
from filters.rotation import FloatArray
from filters.sensors import ImuSpec

POS, VEL, ATT = slice(0, 3), slice(3, 6), slice(6, 9)
GYRO_BIAS, ACCEL_BIAS = slice(9, 12), slice(12, 15)
GYRO_SCALE, ACCEL_SCALE = slice(15, 18), slice(18, 21)


@dataclass(frozen=True)
class ErrorModel:
    """Error-state model of one IMU.

    Parameters
    ----------
    imu : ImuSpec
    states : {15, 21}
        21 adds gyro and accelerometer scale factors.
    """

    imu: ImuSpec
    states: int = 15

    def __post_init__(self) -> None:
        if self.states not in (15, 21):
            raise ConfigError(f"states: expected 15 or 21, found {self.states}")

    def noise(self) -> FloatArray:
        """Return squared noise densities and inverse correlation times as the kernels take them."""
        spec = self.imu
        densities = np.array(
            [
                spec.gyro_noise_density,
                spec.accel_noise_density,
                spec.bias_walk_density(spec.gyro_bias_sigma),
                spec.bias_walk_density(spec.accel_bias_sigma),
            ]
        )
        return np.concatenate([densities**2, np.full(2, 1.0 / spec.bias_correlation_time_s)])

    def initial_covariance(
        self, pos_cov_e: ArrayLike, vel_cov_e: ArrayLike, att_cov_e: ArrayLike
    ) -> FloatArray:
        """Return P, shape (n, n), from the navigation blocks (ECEF) and the sensor's spreads.

        The bias block is turn-on and in-run variance together.
        """
        spec = self.imu
        P = np.zeros((self.states, self.states))
        P[POS, POS], P[VEL, VEL], P[ATT, ATT] = pos_cov_e, vel_cov_e, att_cov_e
        gyro = spec.gyro_bias_initial_sigma**2 + spec.gyro_bias_sigma**2
        accel = spec.accel_bias_initial_sigma**2 + spec.accel_bias_sigma**2
        P[GYRO_BIAS, GYRO_BIAS] = np.eye(3) * gyro
        P[ACCEL_BIAS, ACCEL_BIAS] = np.eye(3) * accel
        if self.states == 21:
            P[GYRO_SCALE, GYRO_SCALE] = np.eye(3) * (1e-6 * spec.gyro_scale_ppm) ** 2
            P[ACCEL_SCALE, ACCEL_SCALE] = np.eye(3) * (1e-6 * spec.accel_scale_ppm) ** 2
        return P

    def transition_matrix(
        self,
        pos_e: ArrayLike,
        C_eb: ArrayLike,
        omega_b: ArrayLike,
        force_b: ArrayLike,
        dt: float,
        scale: ArrayLike = (0.0,) * 6,
    ) -> FloatArray:
        """Return Φ over one short step, shape (n, n), from the code the filter itself runs.

        Parameters
        ----------
        pos_e : array_like, shape (3,)
            [m].
        C_eb : array_like, shape (3, 3)
            At the beginning of the step.
        omega_b, force_b : array_like, shape (3,)
            Angular rate [rad/s] and specific force [m/s²], corrected.
        dt : float
            [s].
        scale : array_like, shape (6,)
            Scale factors of gyro and accelerometer.
        """
        C = np.array(C_eb, dtype=float)
        omega, force = np.asarray(omega_b, dtype=float), np.asarray(force_b, dtype=float)
        divisor = 1.0 + np.asarray(scale, dtype=float)
        M = np.hstack([C, C]) / divisor
        G = np.zeros((3, 3))
        _kernels._gravity_gradient(np.asarray(pos_e, dtype=float), G)
        v, work, zero = np.empty((5, 3)), np.empty((3, 3)), np.zeros(3)
        pos, vel = np.array(pos_e, dtype=float), np.zeros(3)
        _kernels.strapdown_step(pos, vel, C, omega, force, zero, zero, dt, v, work)
        decay = float(np.exp(-dt / self.imu.bias_correlation_time_s))
        phi = np.empty((self.states, self.states))
        out = np.empty(self.states)
        for j, unit in enumerate(np.eye(self.states)):
            _kernels._transition(unit, out, self.states, dt, G, v[0], M, omega, force, decay, decay)
            phi[:, j] = out
        return phi
