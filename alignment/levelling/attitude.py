"""The attitude that a filter starts with, and the velocities it may be found from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...filters.earth import C_en_of
from ...filters.rotation import FloatArray, matrix_from_rpy

#: Largest 1σ of a heading that the filter's linearisation bears [rad]: of the velocity that a
#: heading error δ turns, cos δ and sin δ leave out δ²/2 beside δ. At 10° that is less than a tenth
#: of 1σ and a quarter at 3σ; at 48° the neglected term is as large as what is estimated.
LARGEST_SIGMA_HEADING = np.radians(10.0)


@dataclass(frozen=True, eq=False)
class InitialAttitude:
    """Attitude at one instant with its covariance, ready to start the filter.

    Parameters
    ----------
    time : float
        GPS time [s].
    C_eb : ndarray, shape (3, 3)
    cov_e : ndarray, shape (3, 3)
        Covariance of the attitude error, a small rotation in e axes [rad²].
    sigma_heading : float
        1σ of the heading [rad].
    gyro_bias : ndarray, shape (3,)
        [rad/s]; zero when there was no standstill to take it from.
    sigma_gyro_bias : float or None
        1σ per axis [rad/s]; None: the sensor's turn-on spread holds.
    method, message : str

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import given_attitude
    >>> from certnav.filters import lla_to_ecef
    >>> start = given_attitude(0.0, lla_to_ecef(0.5, 2.0, 30.0), [0.0, 0.0, 1.2], 0.01, 0.05)
    >>> start
    <InitialAttitude 'given' at 0.00 s, heading 1σ 2.86°: attitude as configured>
    >>> np.sqrt(np.linalg.eigvalsh(start.cov_e)).round(3)  # levelled better than headed [rad]
    array([0.01, 0.01, 0.05])
    """

    time: float
    C_eb: FloatArray
    cov_e: FloatArray
    sigma_heading: float
    gyro_bias: FloatArray
    sigma_gyro_bias: float | None
    method: str
    message: str

    def __repr__(self) -> str:
        sigma = f"heading 1σ {np.degrees(self.sigma_heading):.3g}°"
        return f"<InitialAttitude '{self.method}' at {self.time:.2f} s, {sigma}: {self.message}>"


@dataclass(frozen=True, eq=False)
class VelocityTrack:
    """GNSS antenna velocities to align with.

    Parameters
    ----------
    time : ndarray, shape (n,)
        GPS time [s].
    vel_e : ndarray, shape (n, 3)
        [m/s].
    sigma : ndarray, shape (n,)
        1σ per axis [m/s].
    pos_e : ndarray, shape (n, 3)
        Approximate positions [m]; a kilometre is good enough.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import VelocityTrack
    >>> from certnav.filters import C_en_of, lla_to_ecef
    >>> pos_e = np.tile(lla_to_ecef(0.5, 2.0, 30.0), (5, 1))
    >>> vel_e = np.tile(C_en_of(pos_e[0]) @ [8.0, 0.0, 0.0], (5, 1))  # northwards
    >>> track = VelocityTrack(np.arange(5.0), vel_e, np.full(5, 0.05), pos_e)
    >>> track
    <VelocityTrack, 5 epochs>
    >>> np.linalg.norm(track.vel_e, axis=1)
    array([8., 8., 8., 8., 8.])
    """

    time: FloatArray
    vel_e: FloatArray
    sigma: FloatArray
    pos_e: FloatArray

    def __repr__(self) -> str:
        return f"<VelocityTrack, {self.time.size} epochs>"


def attitude_covariance_e(C_en: ArrayLike, sigma_level: float, sigma_heading: float) -> FloatArray:
    """Return the covariance in e axes of independent tilt and heading errors [rad²]."""
    C = np.asarray(C_en, dtype=float)
    return C @ np.diag([sigma_level**2, sigma_level**2, sigma_heading**2]) @ C.T


def given_attitude(
    time: float,
    pos_e: ArrayLike,
    rpy: ArrayLike,
    sigma_level: float,
    sigma_heading: float,
) -> InitialAttitude:
    """Return an attitude that the user states: roll, pitch, heading of the body [rad].

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import given_attitude
    >>> from certnav.filters import lla_to_ecef
    >>> start = given_attitude(0.0, lla_to_ecef(0.5, 2.0, 30.0), [0.0, 0.0, 1.2], 0.01, 0.05)
    >>> start.method, start.sigma_heading
    ('given', 0.05)
    """
    C_en = C_en_of(pos_e)
    return InitialAttitude(
        time, C_en @ matrix_from_rpy(rpy), attitude_covariance_e(C_en, sigma_level, sigma_heading),
        sigma_heading, np.zeros(3), None, "given", "attitude as configured",
    )  # fmt: skip
