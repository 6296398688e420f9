"""Error states of the ECEF mechanisation: their order, their dynamics, their noise.

Errors are true − estimated; the attitude error φ is a small rotation in *body* axes:

    C_eb(true) = C_eb(estimated) (I + [φ×]),    bias(true) = bias + δb

    δp' = δv
    δv' = −C_eb [f×]φ − C_eb δf − 2[ω_ie×]δv + (∂g/∂p)δp
    φ'  = −[ω_ib×]φ − δω

with δf = δb_a + diag(f)δs_a and δω = δb_g + diag(ω)δs_g, each over one plus its scale factor.

Body axes, because the tightest knowledge of an INS is how tilt and accelerometer bias belong
together. With both in body axes that relation does not contain the heading; with φ in e axes an
initial heading error of a few degrees spoils it for good, and the covariance turns optimistic
(seen as attitude NEES of 5 instead of 3; compare Barrau and Bonnabel 2017, invariant filtering).

A bias is a turn-on constant plus an in-run Gauss–Markov part (σ, τ). One state per axis cannot
be both. 'random-walk' keeps the constant and lets the bias wander as the in-run part does over
times shorter than τ (density σ√(2/τ)); 'gauss-markov' lets the whole bias decay with τ, which is
right where the turn-on part has been calibrated away.

Errors of GNSS that outlast an epoch are states too, or the filter would average away what does
not average: the receiver's clock drift, a random walk, and the error that successive positions
share (reflections, ionosphere, orbits), a Gauss–Markov process in units of each position's own
standard deviation.

How the IMU sits in the vehicle is constant and not known exactly: the direction of the vehicle's
forward axis, and where the point is that the wheels constrain; nor are the antenna's place and the
time stamps of GNSS (`filters.levers`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from .compiled import kernels
from .errors import ConfigError
from .gnss_states import CLOCK_DRIFT_SIGMA, shared_root
from .levers import AntennaPrior, VehiclePrior
from .rotation import FloatArray
from .sensors import ImuSpec

POS, VEL, ATT = slice(0, 3), slice(3, 6), slice(6, 9)
GYRO_BIAS, ACCEL_BIAS = slice(9, 12), slice(12, 15)
GYRO_SCALE, ACCEL_SCALE = slice(15, 18), slice(18, 21)
#: Initial 1σ of an odometer's scale factor: tyre wear and pressure.
ODOMETER_SCALE_SIGMA = 0.02


@dataclass(frozen=True)
class ErrorModel:
    """Error-state model of one IMU.

    Parameters
    ----------
    imu : ImuSpec
    states : {15, 21}
        21 adds gyro and accelerometer scale factors.
    bias_model : {'random-walk', 'gauss-markov'}
    odometer : bool
        Whether one more state, the last, is the odometer's scale factor.
    clock_walk : float
        Random walk of the receiver's clock drift [m/s/√s]; 0: no such state.
    fix_correlation : float
        Correlation time of position errors [s]; 0: no such states.
    vehicle : VehiclePrior
        What is known of mounting and wheel point before; exactly: no such states.
    gnss_antenna : AntennaPrior
        What is known of the antenna's place and of time stamps; exactly: no such states.

    Examples
    --------
    >>> from certnav.filters import ErrorModel, imu_preset
    >>> ErrorModel(imu_preset("adis16470")).size
    15
    >>> ErrorModel(imu_preset("adis16470"), states=21, clock_walk=0.1).size  # scale factors, clock
    22
    """

    imu: ImuSpec
    states: int = 15
    bias_model: str = "random-walk"
    odometer: bool = False
    clock_walk: float = 0.0
    fix_correlation: float = 0.0
    vehicle: VehiclePrior = field(default_factory=VehiclePrior)
    gnss_antenna: AntennaPrior = field(default_factory=AntennaPrior)

    def __post_init__(self) -> None:
        if self.states not in (15, 21):
            raise ConfigError(f"states: expected 15 or 21, found {self.states}")
        if self.bias_model not in ("random-walk", "gauss-markov"):
            raise ConfigError(
                f"bias_model: expected 'random-walk' or 'gauss-markov', found '{self.bias_model}'"
            )

    @cached_property
    def size(self) -> int:
        """Length of the error state."""
        delayed = self.gnss_antenna.sigma_delay > 0.0
        return self._vehicle_end + 3 * (self.antenna is not None) + delayed + self.odometer

    @cached_property
    def _gnss_end(self) -> int:
        return self.states + (self.clock_walk > 0) + 3 * (self.fix_correlation > 0)

    @cached_property
    def _vehicle_end(self) -> int:
        prior = self.vehicle
        return self._gnss_end + 2 * (prior.sigma_mounting > 0.0) + 2 * (prior.sigma_wheel > 0.0)

    @cached_property
    def clock(self) -> int | None:
        """Index of the receiver's clock drift [m/s], if it is a state."""
        return self.states if self.clock_walk > 0 else None

    @cached_property
    def fix_bias(self) -> slice | None:
        """The shared error of positions, of unit variance, if it is a state."""
        first = self.states + (self.clock_walk > 0)
        return slice(first, first + 3) if self.fix_correlation > 0 else None

    @cached_property
    def mounting(self) -> slice | None:
        """Pitch and yaw of the vehicle's axes about themselves [rad], if they are states."""
        first = self._gnss_end
        return slice(first, first + 2) if self.vehicle.sigma_mounting > 0.0 else None

    @cached_property
    def wheel(self) -> slice | None:
        """Place of the constrained point, forward and down [m], if it is a state."""
        first = self._gnss_end + 2 * (self.vehicle.sigma_mounting > 0.0)
        return slice(first, first + 2) if self.vehicle.sigma_wheel > 0.0 else None

    @cached_property
    def antenna(self) -> slice | None:
        """Place of the antenna, body axes [m], if it is a state."""
        first = self._vehicle_end
        return slice(first, first + 3) if self.gnss_antenna.sigma_lever > 0.0 else None

    @cached_property
    def delay(self) -> int | None:
        """Index of what GNSS is late beyond its stamps [s], if it is a state."""
        first = self._vehicle_end + 3 * (self.gnss_antenna.sigma_lever > 0.0)
        return first if self.gnss_antenna.sigma_delay > 0.0 else None

    @cached_property
    def bias_decay_rate(self) -> float:
        """Inverse correlation time of the bias states [1/s]; 0 for random walks."""
        return 1.0 / self.imu.bias_correlation_time_s if self.bias_model == "gauss-markov" else 0.0

    def noise(self) -> FloatArray:
        """Return what the kernels take: squared noise densities, inverse correlation times, and
        1 where scale factors are states, else 0.
        """
        spec = self.imu
        densities = np.array(
            [
                spec.gyro_noise_density,
                spec.accel_noise_density,
                spec.bias_walk_density(spec.gyro_bias_sigma),
                spec.bias_walk_density(spec.accel_bias_sigma),
            ]
        )
        tail = [self.bias_decay_rate, self.bias_decay_rate, float(self.states == 21)]
        return np.concatenate([densities**2, tail])

    def initial_covariance(
        self,
        pos_cov_e: ArrayLike,
        vel_cov_e: ArrayLike,
        att_cov_b: ArrayLike,
        shared_cov_e: ArrayLike | None = None,
    ) -> FloatArray:
        """Return P, shape (n, n), from the navigation blocks and the sensor's spreads.

        The bias block is turn-on and in-run variance together.

        Parameters
        ----------
        pos_cov_e, vel_cov_e, att_cov_b : array_like, shape (3, 3)
        shared_cov_e : array_like, shape (3, 3), optional
            Of the position's covariance the part that the positions to come share [m²]; default:
            its error is its own.
        """
        spec = self.imu
        P = np.zeros((self.size, self.size))
        P[POS, POS], P[VEL, VEL], P[ATT, ATT] = pos_cov_e, vel_cov_e, att_cov_b
        gyro = spec.gyro_bias_initial_sigma**2 + spec.gyro_bias_sigma**2
        accel = spec.accel_bias_initial_sigma**2 + spec.accel_bias_sigma**2
        P[GYRO_BIAS, GYRO_BIAS] = np.eye(3) * gyro
        P[ACCEL_BIAS, ACCEL_BIAS] = np.eye(3) * accel
        if self.states == 21:
            P[GYRO_SCALE, GYRO_SCALE] = np.eye(3) * (1e-6 * spec.gyro_scale_ppm) ** 2
            P[ACCEL_SCALE, ACCEL_SCALE] = np.eye(3) * (1e-6 * spec.accel_scale_ppm) ** 2
        if self.clock is not None:
            P[self.clock, self.clock] = CLOCK_DRIFT_SIGMA**2
        if self.fix_bias is not None:
            P[self.fix_bias, self.fix_bias] = np.eye(3)
            if shared_cov_e is not None:
                # What is wrong with the first position is wrong with the next ones.
                root = shared_root(shared_cov_e)
                P[POS, self.fix_bias], P[self.fix_bias, POS] = -root, -root
        if self.mounting is not None:
            P[self.mounting, self.mounting] = np.eye(2) * self.vehicle.sigma_mounting**2
        if self.wheel is not None:
            P[self.wheel, self.wheel] = np.eye(2) * self.vehicle.sigma_wheel**2
        if self.antenna is not None:
            P[self.antenna, self.antenna] = np.eye(3) * self.gnss_antenna.sigma_lever**2
        if self.delay is not None:
            P[self.delay, self.delay] = self.gnss_antenna.sigma_delay**2
        if self.odometer:
            P[-1, -1] = ODOMETER_SCALE_SIGMA**2
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
        C, R, work = np.array(C_eb, dtype=float), np.empty((3, 3)), np.empty((3, 3))
        omega, force = np.asarray(omega_b, dtype=float), np.asarray(force_b, dtype=float)
        pos, vel, v, zero = np.array(pos_e, dtype=float), np.zeros(3), np.empty((5, 3)), np.zeros(3)
        G = np.zeros((3, 3))
        kernels._gravity_gradient(pos, G)
        before = C.copy()
        kernels.strapdown_step(pos, vel, C, omega, force, zero, zero, dt, v, R, work)
        decay = float(np.exp(-dt * self.bias_decay_rate))
        inverse = 1.0 / (1.0 + np.asarray(scale, dtype=float))
        F = np.zeros((6, 3, 3))
        scales = float(self.states == 21)
        kernels.linearise(F, dt, G, v[0], before, R, omega, force, inverse, decay, decay, scales)
        phi = np.eye(self.size)
        phi[GYRO_BIAS, GYRO_BIAS] *= decay
        phi[ACCEL_BIAS, ACCEL_BIAS] *= decay
        kernels.transition(F, np.eye(self.size), phi[:9])
        return phi
