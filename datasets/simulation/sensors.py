"""What an IMU of some grade and a receiver of fixes measure along a trajectory."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ...filters.earth import C_en_of
from ...filters.rotation import FloatArray
from ...filters.sensors import ImuSpec
from ..observations import GnssFixes
from ..series import ImuData
from .trajectory import IMU_POINT, Trajectory


def imu_measurements(
    trajectory: Trajectory,
    times: ArrayLike,
    spec: ImuSpec,
    rng: np.random.Generator,
    noise: bool = True,
    *,
    lever_b: ArrayLike = IMU_POINT,
    scale_factors: bool = False,
) -> tuple[ImuData, FloatArray, FloatArray]:
    """Return what an IMU of grade `spec` measures along a trajectory, and its true biases.

    measured = (1 + s) · true mean + bias + white noise. The bias is a turn-on draw, constant,
    plus an in-run part that starts at zero: Gauss–Markov with σ and τ of `spec`, or the random
    walk that `ImuSpec.bias_walk_density` defines. White noise on a mean over dt has
    σ = density/√dt.

    Parameters
    ----------
    trajectory : Trajectory
    times : array_like, shape (n,)
        Ends of the sample intervals, GPS time [s].
    spec : ImuSpec
    rng : numpy.random.Generator
    noise : bool
        False: the exact means, zero biases.
    lever_b : array_like, shape (3,)
        From the trajectory's IMU point to this sensor, body axes [m].
    scale_factors : bool
        Whether to draw constant scale-factor errors of `spec`'s σ.

    Returns
    -------
    imu : ImuData
    gyro_bias, accel_bias : ndarray, shape (n, 3)
        measured − true at `times` without white noise and scale factor [rad/s], [m/s²].
    """
    time = np.asarray(times, dtype=float)
    gyro_b, accel_b = trajectory.imu_means(time, lever_b)
    if not noise:
        return ImuData(time, gyro_b, accel_b), np.zeros((time.size, 3)), np.zeros((time.size, 3))
    step = np.diff(time, prepend=2.0 * time[0] - time[1])[:, None]

    def corrupt(
        true: FloatArray, ppm: float, turn_on: float, in_run: float, density: float
    ) -> tuple[FloatArray, FloatArray]:
        scale = 1.0 + (1e-6 * ppm * rng.standard_normal(3) if scale_factors else 0.0)
        bias = turn_on * rng.standard_normal(3) + _in_run_bias(time, spec, in_run, rng)
        white = density / np.sqrt(step) * rng.standard_normal(true.shape)
        return scale * true + bias + white, bias

    gyro_b, gyro_bias = corrupt(
        gyro_b,
        spec.gyro_scale_ppm,
        spec.gyro_bias_initial_sigma,
        spec.gyro_bias_sigma,
        spec.gyro_noise_density,
    )
    accel_b, accel_bias = corrupt(
        accel_b,
        spec.accel_scale_ppm,
        spec.accel_bias_initial_sigma,
        spec.accel_bias_sigma,
        spec.accel_noise_density,
    )
    return ImuData(time, gyro_b, accel_b), gyro_bias, accel_bias


def fixes_from_truth(
    trajectory: Trajectory,
    times: ArrayLike,
    lever: ArrayLike,
    sigma_pos: ArrayLike,
    sigma_vel: ArrayLike | None,
    rng: np.random.Generator,
) -> GnssFixes:
    """Return antenna positions and velocities with white Gaussian errors of known covariance.

    Parameters
    ----------
    trajectory : Trajectory
    times : array_like, shape (n,)
        GPS time [s].
    lever : array_like, shape (3,)
        From the IMU to the antenna, body axes [m].
    sigma_pos, sigma_vel : float or array_like, shape (3,)
        1σ in north, east, down [m], [m/s]; one number serves all three; 0 is allowed and puts
        exact values with a covariance of 1e-12. ``sigma_vel=None``: no velocities.
    rng : numpy.random.Generator
    """
    time = np.asarray(times, dtype=float)
    k = trajectory.kinematics(time, lever)
    C_en = C_en_of(k.pos_e)

    def draw(sigma_n: ArrayLike) -> tuple[FloatArray, FloatArray]:
        sigma = np.broadcast_to(np.asarray(sigma_n, dtype=float), (3,))
        error_n = sigma * rng.standard_normal((time.size, 3))
        variance = np.maximum(sigma**2, 1e-12)
        covariance = np.einsum("nij,j,nkj->nik", C_en, variance, C_en)
        return np.einsum("nij,nj->ni", C_en, error_n), covariance

    pos_error, pos_cov = draw(sigma_pos)
    if sigma_vel is None:
        vel_e, vel_cov = np.full((time.size, 3), np.nan), np.full((time.size, 3, 3), np.nan)
    else:
        vel_error, vel_cov = draw(sigma_vel)
        vel_e = k.vel_e + vel_error
    return GnssFixes(
        time=time,
        pos_e=k.pos_e + pos_error,
        pos_cov_e=pos_cov,
        vel_e=vel_e,
        vel_cov_e=vel_cov,
        satellites=np.full(time.size, -1),
        quality=np.full(time.size, "simulated"),
    )


def _in_run_bias(
    time: FloatArray, spec: ImuSpec, sigma: float, rng: np.random.Generator
) -> FloatArray:
    """Return an in-run bias history that starts at zero, shape (n, 3), exact at any spacing."""
    tau = spec.bias_correlation_time_s
    white = rng.standard_normal((time.size - 1, 3))
    age = time - time[0]
    bias = np.zeros((time.size, 3))
    if np.isinf(tau):
        step = np.sqrt(np.diff(age))[:, None] * spec.bias_walk_density(sigma)
        bias[1:] = np.cumsum(step * white, axis=0)
        return bias
    # b_k = φ_k b_{k-1} + σ√(1 − φ_k²) w_k summed as e^{-t_k/τ} Σ e^{t_j/τ} …, in stretches of a
    # few time constants so that the exponentials stay moderate.
    drive = sigma * np.sqrt(-np.expm1(-2.0 * np.diff(age) / tau))[:, None] * white
    stretch = np.floor(age / (10.0 * tau)).astype(int)
    for k in range(int(stretch[-1]) + 1):
        first, last = np.searchsorted(stretch, [k, k + 1])
        first = max(int(first), 1)
        growth = np.exp((age[first:last] - age[first - 1]) / tau)[:, None]
        total = bias[first - 1] + np.cumsum(growth * drive[first - 1 : last - 1], axis=0)
        bias[first:last] = total / growth
    return bias
