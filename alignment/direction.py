"""Nose or tail first? Which of two headings fits the accelerations, and whether one does.

A course says where a vehicle goes, not where it points. Whichever way it points, its velocity
changes as GNSS sees it; what the accelerometers feel, turned with the wrong heading, is that change
with the opposite sign. A turn decides it as well as a change of speed; a straight road at constant
speed leaves both open.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..filters.earth import C_en_of, gravity_e
from ..filters.errors import AlignmentError
from ..filters.rotation import FloatArray
from ..filters.strapdown import InertialStream
from .in_motion.track import inertial_track
from .levelling import LARGEST_SIGMA_HEADING, InitialAttitude, VelocityTrack
from .velocity_matching import HeadingOffset, heading_offset

#: How far from the instant of the attitude gyros alone are believed [s].
_REACH = 30.0
#: Vibration, time stamps, lever arm: 1σ of a change of velocity, beside GNSS's own [m/s].
_FLOOR = 0.15
#: χ²/dof beyond which neither fits: velocities of twice the noise that is assumed.
_NEITHER = 4.0
#: A velocity that counts for less than this beside the others is not one to start from.
_BORNE_OUT = 0.3
#: Velocities nearer than this share their reflections [s].
_SHARED = 3.0
#: Epochs further apart than this do not make a difference worth having [s].
_LONGEST = 2.5


def log_odds(
    stream: InertialStream,
    track: VelocityTrack,
    forwards: InitialAttitude,
    backwards: InitialAttitude,
) -> float:
    """Return how much more likely the first of two attitudes is, as a natural logarithm.

    Parameters
    ----------
    stream : InertialStream
    track : VelocityTrack
        What there is so far.
    forwards, backwards : InitialAttitude
        Of one instant.

    Returns
    -------
    float
        ln of the likelihood ratio; 0 where nothing tells.
    """
    k = _epochs_around(stream, track, forwards.time)
    if k.size < 3:
        return 0.0
    try:
        fits = [_misfit(stream, track, k, attitude) for attitude in (forwards, backwards)]
    except AlignmentError:
        return 0.0
    (chi2_f, dof), (chi2_b, _) = fits
    # Noise that is larger than assumed makes both fit badly, and the difference worth less.
    scale = max(1.0, min(chi2_f, chi2_b) / max(dof, 1))
    if scale > _NEITHER:
        return 0.0  # whichever fits less badly
    return 0.5 * (chi2_b - chi2_f) / scale


class Fit(NamedTuple):
    """What accelerometers say of a heading from the course.

    Attributes
    ----------
    against : str
        Why it is not to be believed; '' where nothing speaks against it.
    sigma : float
        1σ of the heading by the accelerations alone [rad]; inf where they tell nothing.
    borne_out : bool
        Whether velocities of other seconds have the same heading. The one that the course is of,
        and those that share its reflections, do not count: after a standstill any velocity has
        the course that the accelerations have with it.
    """

    against: str = ""
    sigma: float = float("inf")
    borne_out: bool = False


def course_fit(stream: InertialStream, track: VelocityTrack, attitude: InitialAttitude) -> Fit:
    """Hold a heading from the course against the accelerations around it.

    A velocity that reflections have made has a course, too. The accelerometers bear out neither
    that velocity nor that heading.

    Parameters
    ----------
    stream : InertialStream
    track : VelocityTrack
    attitude : InitialAttitude
        With its heading from a velocity of the track.
    """
    k = _epochs_around(stream, track, attitude.time)
    found = _offset(stream, track, k, attitude)
    apart = k[np.abs(track.time[k] - attitude.time) > _SHARED]
    others = _offset(stream, track, apart, attitude)
    for each in (found, others):
        if each is None:
            continue
        if each.contradicts:
            return Fit(f"velocities change {each.scale:.1f} times as much as accelerometers feel")
        limit = 3.0 * float(np.hypot(each.sigma, attitude.sigma_heading))
        if each.tells and abs(each.offset) > max(LARGEST_SIGMA_HEADING, limit):
            off = np.degrees(abs(each.offset))
            text = f"the accelerations have the heading {off:.0f}° beside the course"
            return Fit(text, each.sigma)
    if found is None:
        return Fit()
    sigma = found.sigma if found.tells else float("inf")
    used = np.flatnonzero(np.abs(track.time[k] - attitude.time) < 1e-6)
    if found.tells and used.size and found.weight[used[0]] < _BORNE_OUT:
        against = "the accelerations do not bear out the velocity that the course is of"
        return Fit(against, sigma)
    known = others is not None and others.tells and others.sigma <= LARGEST_SIGMA_HEADING
    return Fit("", sigma, known)


def _offset(
    stream: InertialStream, track: VelocityTrack, k: np.ndarray, attitude: InitialAttitude
) -> HeadingOffset | None:
    """Return what the velocities of these epochs say of the heading."""
    if k.size < 3:
        return None
    time = np.union1d(track.time[k], [attitude.time])
    imu = inertial_track(stream, time, attitude.gyro_bias)
    C_ne = C_en_of(track.pos_e[k[0]]).T
    C_nw = C_ne @ attitude.C_eb @ imu.C_wb[np.searchsorted(time, attitude.time)].T
    rows = np.searchsorted(time, track.time[k])
    return heading_offset(
        track.time[k], (track.vel_e[k] @ C_ne.T)[:, :2], track.sigma[k],
        (imu.dv_w[rows] @ C_nw.T)[:, :2], C_nw @ imu.C_wb[rows],
    )  # fmt: skip


def _epochs_around(stream: InertialStream, track: VelocityTrack, time: float) -> np.ndarray:
    """Return the epochs that gyros reach from a time."""
    inside = (track.time > stream.start + 0.05) & (track.time < stream.end - 0.05)
    k = np.flatnonzero(inside & (np.abs(track.time - time) <= _REACH))
    return np.asarray(k[np.diff(track.time[k], prepend=-np.inf) > 1e-3])


def _misfit(
    stream: InertialStream, track: VelocityTrack, k: np.ndarray, attitude: InitialAttitude
) -> tuple[float, int]:
    """Return χ² of the changes of horizontal velocity, and degrees of freedom.

    A constant error of level and accelerometer, in body axes, is left free.
    """
    time = np.union1d(track.time[k], [attitude.time])
    imu = inertial_track(stream, time, attitude.gyro_bias)
    at = int(np.searchsorted(time, attitude.time))
    C_ew = attitude.C_eb @ imu.C_wb[at].T
    rows = np.searchsorted(time, track.time[k])
    C_en = C_en_of(track.pos_e[k[0]])
    dt = np.diff(track.time[k])
    felt_e = np.diff(imu.dv_w[rows], axis=0) @ C_ew.T
    felt_e = felt_e + gravity_e(track.pos_e[k[0]]) * dt[:, None]
    off = (np.diff(track.vel_e[k], axis=0) - felt_e) @ C_en[:, :2]
    C_nb = C_en.T @ C_ew @ imu.C_wb[rows[:-1]]
    sigma = np.sqrt(track.sigma[k][1:] ** 2 + track.sigma[k][:-1] ** 2 + _FLOOR**2)
    near = dt <= _LONGEST
    y = (off / sigma[:, None])[near].ravel()
    A = (C_nb[:, :2, :] * (dt / sigma)[:, None, None])[near].reshape(-1, 3)
    if y.size < 4:
        raise AlignmentError("too few changes of velocity")
    rest: FloatArray = y - A @ np.linalg.lstsq(A, y, rcond=1e-6)[0]
    return float(rest @ rest), y.size - 3
