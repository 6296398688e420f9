"""Levelling and course: the attitude at the first epoch whose course is known well enough."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ...filters.earth import OMEGA_IE_E, C_en_of
from ...filters.errors import AlignmentError
from ...filters.rotation import FloatArray, matrix_from_rpy
from ...filters.sensors import ImuSpec
from ...filters.strapdown import InertialStream
from .attitude import (
    LARGEST_SIGMA_HEADING,
    InitialAttitude,
    VelocityTrack,
    attitude_covariance_e,
)
from .level import carry_from_rest, level_at_rest, level_in_motion
from .rest import rest_before


def level_and_course(
    stream: InertialStream,
    track: VelocityTrack,
    C_bv: ArrayLike,
    imu: ImuSpec,
    *,
    min_speed: float = 3.0,
    sigma_level: float = np.radians(0.5),
    sigma_heading: float = np.radians(2.0),
    max_sigma_heading: float = LARGEST_SIGMA_HEADING,
    backwards: bool = False,
    after: float = -np.inf,
) -> InitialAttitude:
    """Align by levelling and course at the first epoch whose course is known well enough.

    Parameters
    ----------
    stream : InertialStream
    track : VelocityTrack
    C_bv : array_like, shape (3, 3)
        Vehicle mounting.
    imu : ImuSpec
        For the share of accelerometer and gyro bias in the uncertainty.
    min_speed : float
        Horizontal speed from which course counts as heading [m/s].
    sigma_level, sigma_heading : float
        Lower bounds of the resulting 1σ [rad].
    max_sigma_heading : float
        Largest 1σ of a course that is taken for a heading [rad].
    backwards : bool
        The vehicle drives tail first (`alignment.direction` says which fits).
    after : float
        GPS time before which nothing counts [s].

    Raises
    ------
    AlignmentError
        If the vehicle never gets fast enough, or there is no IMU data around that time.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import VelocityTrack, level_and_course
    >>> from certnav.filters import C_en_of, InertialStream, imu_preset, lla_to_ecef
    >>> from certnav.filters import rpy_from_matrix
    >>> pos_e = np.tile(lla_to_ecef(0.5, 2.0, 30.0), (9, 1))
    >>> C_en = C_en_of(pos_e[0])
    >>> vel_e = np.tile(C_en @ [0.0, 8.0, 0.0], (9, 1))  # eastwards
    >>> track = VelocityTrack(np.arange(9.0), vel_e, np.full(9, 0.05), pos_e)
    >>> time = np.arange(0.01, 9.0, 0.01)
    >>> still = np.zeros((time.size, 3))
    >>> stream = InertialStream(time, still, still + [0.0, 0.0, -9.8])
    >>> start = level_and_course(stream, track, np.eye(3), imu_preset("adis16470"))
    >>> np.degrees(rpy_from_matrix(C_en.T @ start.C_eb)).round(1) + 0.0
    array([ 0.,  0., 90.])
    """
    C_bv = np.asarray(C_bv, dtype=float)
    k, vel_n, C_en = _first_fast_epoch(stream, track, min_speed, max_sigma_heading, after)
    time = float(track.time[k])
    speed = float(np.hypot(vel_n[0], vel_n[1]))
    heading = float(np.arctan2(vel_n[1], vel_n[0])) + (np.pi if backwards else 0.0)
    rest = rest_before(stream, track, k, imu, C_bv)
    bias_tilt = np.hypot(imu.accel_bias_initial_sigma, imu.accel_bias_sigma) / 9.8
    if rest is not None:
        C_hb, mean_rate, elapsed, _ = carry_from_rest(stream, rest, time, C_bv)
        drift = imu.gyro_bias_sigma * elapsed + imu.gyro_noise_density * np.sqrt(elapsed)
        tilt = float(np.sqrt(bias_tilt**2 + drift**2))
    else:
        C_hb = level_in_motion(stream, track, k, heading, C_bv)
        mean_rate = None
        tilt = float(np.hypot(bias_tilt, np.radians(2.0)))
    # C_hb has an arbitrary azimuth; turn it so that the vehicle's nose has the heading.
    nose = (C_hb @ C_bv)[:, 0]
    turn = matrix_from_rpy([0.0, 0.0, heading - np.arctan2(nose[1], nose[0])])
    C_eb = C_en @ turn @ C_hb
    sigma_psi = max(float(track.sigma[k]) / speed, sigma_heading)
    gyro_bias, sigma_bias = np.zeros(3), None
    if rest is not None and mean_rate is not None:
        start, end = rest
        C_eb_rest = C_en @ turn @ level_at_rest(stream, rest, C_bv)
        gyro_bias = mean_rate - C_eb_rest.T @ OMEGA_IE_E
        # The standstill's own noise, and what the bias does later.
        sigma_bias = float(
            np.hypot(imu.gyro_noise_density / np.sqrt(end - start), imu.gyro_bias_sigma)
        )
    how = "levelled in motion"
    if rest is not None:
        how = f"levelled over {rest[1] - rest[0]:.0f} s at rest"
    return InitialAttitude(
        time, C_eb, attitude_covariance_e(C_en, max(tilt, sigma_level), sigma_psi), sigma_psi,
        gyro_bias, sigma_bias, "level+course",
        f"{how}, heading from course at {speed:.1f} m/s{', reversing' if backwards else ''}",
    )  # fmt: skip


def _first_fast_epoch(
    stream: InertialStream,
    track: VelocityTrack,
    min_speed: float,
    max_sigma: float,
    after: float,
) -> tuple[int, FloatArray, FloatArray]:
    """Return the first epoch at `min_speed` with a course good enough, its NED velocity, C_en."""
    inside = (track.time > max(stream.start + 1.0, after)) & (track.time < stream.end)
    if not inside.any():
        raise AlignmentError(
            "no GNSS velocity within the IMU data — is there Doppler, and do the times overlap?"
        )
    C_en = C_en_of(track.pos_e[np.flatnonzero(inside)[0]])
    vel_n = track.vel_e @ C_en
    speed = np.hypot(vel_n[:, 0], vel_n[:, 1])
    # Two epochs in a row, so that one wild velocity does not make a heading.
    steady = np.append((speed[:-1] > 0.6 * min_speed) & (speed[1:] > 0.6 * min_speed), False)
    steady[1:] |= steady[:-1]
    fast = np.flatnonzero(inside & steady & (speed >= min_speed))
    if not fast.size:
        fastest = speed[inside].max()
        twice = "twice in a row " if fastest >= min_speed else ""
        raise AlignmentError(
            f"no heading: the vehicle never reaches {min_speed:.1f} m/s {twice}(fastest "
            f"{fastest:.1f} m/s) — lower alignment.min_speed_mps or give "
            "alignment.heading_deg, roll_deg and pitch_deg"
        )
    known = fast[track.sigma[fast] <= max_sigma * speed[fast]]
    if not known.size:
        best = float(np.degrees(np.min(track.sigma[fast] / speed[fast])))
        raise AlignmentError(
            f"no heading: the course is known to ±{best:.0f}° at best (limit "
            f"{np.degrees(max_sigma):.0f}°) — more satellites or more speed would help, or give "
            "alignment.heading_deg, roll_deg and pitch_deg"
        )
    k = int(known[0])
    return k, vel_n[k], C_en
