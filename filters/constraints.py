"""What a road vehicle does not do: measurement models of standstill, no side slip, odometer.

Each returns z, H, R as in `filters.measurements`. The lateral and vertical velocity is zero at
the point the wheels constrain, the middle of the rear axle, not at the IMU: in a turn they differ
by the lever arm times the rate. Where that point lies and how the IMU is turned in the vehicle is a
`VehiclePoint`; what of it is estimated has its columns in H.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .earth import OMEGA_IE_E, gravity_e
from .error_model import ACCEL_BIAS, ATT, GYRO_BIAS, VEL
from .levers import VehiclePoint, lever_velocity, rate_over_earth
from .measurements import Biases, Measurement
from .rotation import FloatArray, skew
from .strapdown import NavState

#: What a vehicle may do all the same for a while, 1σ [m/s]: slide, skid, take a ramp.
_LARGEST = 3.0


def vehicle_velocity(state: NavState, omega_b: ArrayLike, point: VehiclePoint) -> FloatArray:
    """Return the velocity of the constrained point in vehicle axes [m/s].

    Parameters
    ----------
    state : NavState
    omega_b : array_like, shape (3,)
        ω_ib^b, corrected [rad/s].
    point : VehiclePoint
    """
    rate_b = rate_over_earth(state.C_eb, omega_b)
    vel_e = state.vel_e + lever_velocity(state.C_eb, rate_b, point.lever_b)
    vel_v: FloatArray = point.C_bv.T @ (state.C_eb.T @ vel_e)
    return vel_v


def _linear(
    state: NavState, states: int, omega_b: ArrayLike, point: VehiclePoint
) -> tuple[FloatArray, FloatArray]:
    """Return `vehicle_velocity` and its derivative with respect to the error state."""
    C_be, arm, C_vb = state.C_eb.T, skew(point.lever_b), point.C_bv.T
    vel_v = vehicle_velocity(state, omega_b, point)
    H = np.zeros((3, states))
    H[:, VEL] = C_be
    H[:, ATT] = skew(C_be @ state.vel_e) + arm @ skew(C_be @ OMEGA_IE_E)
    H[:, GYRO_BIAS] = arm
    H = C_vb @ H
    # C_bv(true) = C_bv (I + [μ×]): v_v(true) = v_v − μ × v_v. The lever is kept in body axes.
    if point.mounting is not None:
        H[:, point.mounting] = skew(vel_v)[:, 1:]
    if point.wheel is not None:
        H[:, point.wheel] = skew(C_vb @ rate_over_earth(state.C_eb, omega_b))[:, [0, 2]]
    return vel_v, H


def non_holonomic(
    state: NavState,
    states: int,
    omega_b: ArrayLike,
    point: VehiclePoint,
    sigma: ArrayLike,
) -> Measurement:
    """No lateral and no vertical velocity in vehicle axes.

    Parameters
    ----------
    state, omega_b, point
        As for `vehicle_velocity`.
    states : int
        Length of the error state.
    sigma : array_like, shape (2,)
        1σ of the lateral and vertical velocity that tyres and springs allow [m/s].
    """
    vel_v, H = _linear(state, states, omega_b, point)
    lateral, vertical = (np.asarray(sigma, dtype=float) * np.ones(2)).tolist()
    R = np.array([[lateral**2, 0.0], [0.0, vertical**2]])
    return Measurement(-vel_v[1:], H[1:], R, Biases(("sideslip", "heave"), np.eye(2), _LARGEST))


def odometer(
    state: NavState,
    states: int,
    omega_b: ArrayLike,
    point: VehiclePoint,
    speed: float,
    sigma: float,
    scale: float,
) -> Measurement:
    """Forward speed of the constrained point, (1 + scale) times the true one.

    Parameters
    ----------
    state, omega_b, point
        As for `vehicle_velocity`.
    states : int
        Length of the error state; its last element is the odometer's scale factor.
    speed, sigma : float
        Measured speed and its 1σ [m/s].
    scale : float
        Current estimate of the scale factor.
    """
    vel_v, by_state = _linear(state, states, omega_b, point)
    forward = float(vel_v[0])
    H = (1.0 + scale) * by_state[:1]
    H[0, -1] = forward
    z = np.array([speed - (1.0 + scale) * forward])
    return Measurement(z, H, np.array([[sigma**2]]), Biases(("wheel slip",), np.eye(1), _LARGEST))


def zero_velocity(state: NavState, states: int, sigma: float) -> Measurement:
    """Standstill: no velocity with respect to the Earth, 1σ `sigma` [m/s] per axis."""
    H = np.zeros((3, states))
    H[:, VEL] = np.eye(3)
    return Measurement(-state.vel_e, H, np.eye(3) * sigma**2)


def zero_rate(
    state: NavState, states: int, gyro_b: ArrayLike, gyro_bias: ArrayLike, sigma: float
) -> Measurement:
    """Standstill: the gyros measure their bias and the Earth's rate, nothing else.

    Parameters
    ----------
    state : NavState
    states : int
        Length of the error state.
    gyro_b : array_like, shape (3,)
        Mean measured rate over the standstill's interval [rad/s].
    gyro_bias : array_like, shape (3,)
        Current estimate [rad/s].
    sigma : float
        1σ of that mean per axis [rad/s].
    """
    earth_b = state.C_eb.T @ OMEGA_IE_E
    H = np.zeros((3, states))
    H[:, GYRO_BIAS] = np.eye(3)
    H[:, ATT] = skew(earth_b)
    z = np.asarray(gyro_b, dtype=float) - np.asarray(gyro_bias, dtype=float) - earth_b
    return Measurement(z, H, np.eye(3) * sigma**2)


def zero_acceleration(
    state: NavState, states: int, force_b: ArrayLike, accel_bias: ArrayLike, sigma: float
) -> Measurement:
    """Standstill: the accelerometers measure their bias and the reaction to gravity, nothing else.

    Parameters
    ----------
    state : NavState
    states : int
        Length of the error state.
    force_b : array_like, shape (3,)
        Mean measured specific force over the standstill's interval [m/s²].
    accel_bias : array_like, shape (3,)
        Current estimate [m/s²].
    sigma : float
        1σ of that mean per axis [m/s²].
    """
    force = np.asarray(force_b, dtype=float) - np.asarray(accel_bias, dtype=float)
    H = np.zeros((3, states))
    H[:, ATT] = -state.C_eb @ skew(force)
    H[:, ACCEL_BIAS] = -state.C_eb
    z = -(state.C_eb @ force + gravity_e(state.pos_e))
    return Measurement(z, H, np.eye(3) * sigma**2)
