"""DDIA-VE as an update of the filter: direction from the filter's attitude, speed from Doppler.

The velocity was computed with the filter's own attitude, so its error is not independent of the
filter's. `measurement` therefore takes the covariance without the attitude's share and puts that
share where it belongs, into H.
"""

from __future__ import annotations

import numpy as np

from ...datasets.sequence import Calibration
from ...filters import measurements
from ...filters.ekf import ErrorStateFilter
from ...filters.error_model import ATT
from ...filters.levers import rate_over_earth
from ...filters.measurements import Measurement
from ...velocity.ddia import AidedVelocity
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
    return forward_motion(
        kalman.C_eb,
        rate_over_earth(kalman.C_eb, kalman.omega_b),
        calibration.lever_antenna_b,
        C_bv=calibration.C_bv,
        lever_vehicle_b=calibration.lever_vehicle_b,
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
    m = measurements.velocity(
        kalman.state, kalman.model.size, aided.vel_e, cov, calibration.lever_antenna_b,
        kalman.omega_b,
    )  # fmt: skip
    H = m.H.copy()
    # φ (true − estimated, body) is −φ' of `ddia` in body axes.
    H[:, ATT] -= aided.attitude_e @ kalman.C_eb
    return Measurement(m.z, H, m.R)
