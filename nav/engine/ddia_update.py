"""DDIA-VE as an update of the filter: direction from the filter's attitude, speed from Doppler.

The velocity was computed with the filter's own attitude, rate, mounting and wheel point, so its
error is not independent of the filter's. `measurement` takes the covariance without their share
and puts that share where it belongs, into H.
"""

from __future__ import annotations

import numpy as np

from ...datasets.sequence import Calibration
from ...filters import measurements
from ...filters.ekf import ErrorStateFilter
from ...filters.error_model import ATT, GYRO_BIAS
from ...filters.levers import rate_over_earth
from ...filters.measurements import Measurement
from ...filters.rotation import skew
from ...velocity.aided_velocity import AidedVelocity
from ...velocity.vehicle_motion import ForwardMotion, forward_motion

#: 1σ of a car's velocity across its own axis, per axis [m/s]: sideslip and suspension.
SIGMA_CROSS = 0.1


def filter_motion(
    kalman: ErrorStateFilter, calibration: Calibration, sigma_cross: float = SIGMA_CROSS
) -> ForwardMotion:
    """Return direction and lever-arm velocity according to the filter at its present time.

    Parameters
    ----------
    kalman : ErrorStateFilter
        Propagated to the epoch.
    calibration : Calibration
        Levers and mounting.
    sigma_cross : float
        See `ForwardMotion`.
    """
    point = kalman.vehicle.point(calibration.C_bv, calibration.lever_vehicle_b)
    return forward_motion(
        kalman.C_eb,
        rate_over_earth(kalman.C_eb, kalman.omega_b),
        kalman.antenna_point(calibration.lever_antenna_b).lever_b,
        C_bv=point.C_bv,
        lever_vehicle_b=point.lever_b,
        att_cov_e=kalman.C_eb @ kalman.P[ATT, ATT] @ kalman.C_eb.T,
        sigma_cross=sigma_cross,
    )


def measurement(
    kalman: ErrorStateFilter,
    aided: AidedVelocity,
    calibration: Calibration,
    *,
    sigma_scale: float = 1.0,
    sigma_floor: float = 0.02,
) -> Measurement:
    """Return z, H, R of a velocity that `filter_motion` of the same instant went into.

    Parameters
    ----------
    kalman : ErrorStateFilter
    aided : AidedVelocity
    calibration : Calibration
    sigma_scale, sigma_floor : float
        Factor on the standard deviations, and what is added to them on every axis [m/s].
    """
    cov = aided.noise_cov_e * sigma_scale**2 + np.eye(3) * sigma_floor**2
    antenna = kalman.antenna_point(calibration.lever_antenna_b)
    m = measurements.velocity(
        kalman.state, kalman.model.size, aided.vel_e, cov, antenna, kalman.omega_b
    )
    H = m.H.copy()
    # φ (true − estimated, body) is −φ' of `ddia` in body axes.
    H[:, ATT] -= aided.attitude_e @ kalman.C_eb
    # The swing is C [ω×] (l_antenna − l_wheel), ω = measured − bias; what it is too large by, the
    # velocity is too large by (I − u gᵀE) of that.
    point = kalman.vehicle.point(calibration.C_bv, calibration.lever_vehicle_b)
    swing_b = aided.swing_e @ kalman.C_eb
    H[:, GYRO_BIAS] -= swing_b @ skew(antenna.lever_b - point.lever_b)
    if antenna.lever is not None:
        H[:, antenna.lever] -= swing_b @ skew(antenna.rate_b)
    if point.wheel is not None:
        rate_b = rate_over_earth(kalman.C_eb, kalman.omega_b)
        H[:, point.wheel] = (swing_b @ skew(rate_b) @ point.C_bv)[:, [0, 2]]
    if point.mounting is not None:
        # In vehicle axes the speed is s (1, 0, 0); the mounting's error turns it alone.
        ahead_v = skew(np.array([aided.speed, 0.0, 0.0]))
        H[:, point.mounting] = (swing_b @ point.C_bv @ ahead_v)[:, 1:]
    return Measurement(m.z, H, m.R)
