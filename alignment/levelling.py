"""Initial attitude by levelling and GNSS course.

The conventional start of a loosely coupled filter: roll and pitch from the specific force, at
rest if the data begin with a standstill and against the GNSS acceleration otherwise; heading
from the course once the vehicle moves, on the assumption that it goes where it points.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..filters.earth import OMEGA_IE_E, C_en_of, gravity_e
from ..filters.errors import AlignmentError
from ..filters.rotation import FloatArray, matrix_from_rotvec, matrix_from_rpy, rpy_from_matrix
from ..filters.sensors import ImuSpec
from ..filters.standstill import is_quiet, own_spread
from ..filters.strapdown import InertialStream

#: Longest window used for levelling [s].
LEVEL_WINDOW = 20.0
#: Shortest standstill that counts as one [s].
SHORTEST_REST = 2.0
#: The same where GNSS was silent [s]: steady braking is quiet, but shorter.
SHORTEST_UNSEEN = 3.0
#: Time over which spread and mean are taken, to find one [s].
_BLOCK = 1.0
#: Largest 1σ of a heading that the filter's linearisation bears [rad]: of the velocity that a
#: heading error δ turns, cos δ and sin δ leave out δ²/2 beside δ. At 10° that is less than a tenth
#: of 1σ and a quarter at 3σ; at 48° the neglected term is as large as what is estimated.
LARGEST_SIGMA_HEADING = np.radians(10.0)
#: GNSS speed above which the vehicle is certainly moving [m/s].
REST_SPEED = 0.5
#: Change of the blocks' means, per axis, within a quiet stretch.
_DRIFT_GYRO, _DRIFT_ACCEL = np.radians(0.2), 0.08
#: Error of the speed gained since a standstill, per second: half of 10 mg.
_DOUBT_ACCEL = 0.05
#: A wrong level, from a bend taken for a standstill, makes any speed in more than this [s].
_LONG_AGO = 15.0


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
    """Return an attitude that the user states: roll, pitch, heading of the body [rad]."""
    C_en = C_en_of(pos_e)
    return InitialAttitude(
        time, C_en @ matrix_from_rpy(rpy), attitude_covariance_e(C_en, sigma_level, sigma_heading),
        sigma_heading, np.zeros(3), None, "given", "attitude as configured",
    )  # fmt: skip


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
    """
    C_bv = np.asarray(C_bv, dtype=float)
    k, vel_n, C_en = _first_fast_epoch(stream, track, min_speed, max_sigma_heading, after)
    time = float(track.time[k])
    speed = float(np.hypot(vel_n[0], vel_n[1]))
    heading = float(np.arctan2(vel_n[1], vel_n[0])) + (np.pi if backwards else 0.0)
    rest = _rest_before(stream, track, k, imu, C_bv)
    bias_tilt = np.hypot(imu.accel_bias_initial_sigma, imu.accel_bias_sigma) / 9.8
    if rest is not None:
        C_hb, mean_rate, elapsed, _ = _carry_from_rest(stream, rest, time, C_bv)
        drift = imu.gyro_bias_sigma * elapsed + imu.gyro_noise_density * np.sqrt(elapsed)
        tilt = float(np.sqrt(bias_tilt**2 + drift**2))
    else:
        C_hb = _level_in_motion(stream, track, k, heading, C_bv)
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
        C_eb_rest = C_en @ turn @ _level_at_rest(stream, rest, C_bv)
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


def _samples(stream: InertialStream, start: float, end: float) -> slice:
    """Return the samples whose intervals lie within the two times."""
    first = int(np.searchsorted(stream.edges, start - 1e-6))
    last = int(np.searchsorted(stream.edges, end + 1e-6, side="right")) - 1
    return slice(first, max(last, first))


def _rest_before(
    stream: InertialStream, track: VelocityTrack, k: int, imu: ImuSpec, C_bv: FloatArray
) -> tuple[float, float] | None:
    """Return begin and end of the last standstill before epoch k.

    The IMU says when it was quiet. Steady driving is quiet as well: that the vehicle stood is for
    GNSS to say, by a velocity then or, where it was silent, by the first one after.
    """
    for start, stop in _quiet_stretches(stream, float(track.time[k]), imu):
        within = (track.time >= start) & (track.time <= stop)
        if within.any():
            speed = np.linalg.norm(track.vel_e[within], axis=1)
            stood = bool(np.all(speed <= np.maximum(REST_SPEED, 3.0 * track.sigma[within])))
        else:
            long = stop - start >= SHORTEST_UNSEEN - 1e-6
            stood = long and _gained_all_its_speed(stream, track, (start, stop), C_bv)
        if stood:
            return start, stop
    return None


def _quiet_stretches(
    stream: InertialStream, until: float, imu: ImuSpec
) -> Iterator[tuple[float, float]]:
    """Yield begin and end of quiet stretches before a time, the last first.

    Quiet is judged by the IMU alone, second by second.
    """
    last = int(np.searchsorted(stream.edges, until)) - 1
    dt = float(np.median(np.diff(stream.edges[: last + 1]))) if last > 1 else np.inf
    n = max(round(_BLOCK / dt), 2)
    blocks = last // n
    if blocks < 1:
        return
    gyro = stream.gyro[: blocks * n].reshape(blocks, n, 3)
    accel = stream.accel[: blocks * n].reshape(blocks, n, 3)
    own_gyro, own_accel = own_spread(imu, dt)
    quiet = is_quiet(gyro, accel, imu, dt, 3.0)
    # The noise of a block's mean on top of what may drift.
    limit_gyro = _DRIFT_GYRO + 6.0 * own_gyro / np.sqrt(n)
    limit_accel = _DRIFT_ACCEL + 6.0 * own_accel / np.sqrt(n)
    edge = stream.edges[np.arange(blocks + 1) * n]
    mean_gyro, mean_accel = gyro.mean(axis=1), accel.mean(axis=1)
    end = blocks - 1
    while end >= 0:
        if not quiet[end]:
            end -= 1
            continue
        first = end
        while (
            first > 0
            and quiet[first - 1]
            and edge[end + 1] - edge[first - 1] <= LEVEL_WINDOW
            and np.all(np.abs(mean_gyro[first - 1] - mean_gyro[end]) < limit_gyro)
            and np.all(np.abs(mean_accel[first - 1] - mean_accel[end]) < limit_accel)
        ):
            first -= 1
        if edge[end + 1] - edge[first] >= SHORTEST_REST - 1e-6:
            yield float(edge[first]), float(edge[end + 1])
        end = first - 1


def _gained_all_its_speed(
    stream: InertialStream, track: VelocityTrack, rest: tuple[float, float], C_bv: FloatArray
) -> bool:
    """Tell if the first velocity after a quiet stretch is what the accelerometers added since.

    After a standstill it is; after steady driving it lacks the speed that was there before. Where
    it is long ago, or slow now, the accelerometers cannot tell.
    """
    after = np.flatnonzero(track.time > rest[1])
    if not after.size or track.time[after[0]] > min(stream.end, rest[1] + _LONG_AGO):
        return False
    j = int(after[0])
    speed = float(np.linalg.norm(track.vel_e[j]))
    *_, elapsed, gained = _carry_from_rest(stream, rest, float(track.time[j]), C_bv)
    doubt = REST_SPEED + 3.0 * float(track.sigma[j]) + _DOUBT_ACCEL * elapsed
    return abs(gained - speed) < doubt < max(0.5 * speed, 2.0 * REST_SPEED)


def _level(force_v: FloatArray, force_h: FloatArray) -> FloatArray:
    """Return C_hv, without turn about the vertical, that takes force_v to force_h (directions)."""
    a = force_v / np.linalg.norm(force_v)
    b = force_h / np.linalg.norm(force_h)
    C = np.eye(3)
    for _ in range(20):
        step = np.cross(C @ a, b)
        step[2] = 0.0
        C = matrix_from_rotvec(step) @ C
        if np.linalg.norm(step) < 1e-12:
            break
    roll, pitch, _ = rpy_from_matrix(C)
    return matrix_from_rpy([roll, pitch, 0.0])


def _level_at_rest(
    stream: InertialStream, rest: tuple[float, float], C_bv: FloatArray
) -> FloatArray:
    """Return C_hb from the mean specific force of a standstill; h is level, azimuth arbitrary."""
    force_v = C_bv.T @ stream.accel[_samples(stream, *rest)].mean(axis=0)
    return _level(force_v, np.array([0.0, 0.0, -1.0])) @ C_bv.T


def _carry_from_rest(
    stream: InertialStream, rest: tuple[float, float], time: float, C_bv: FloatArray
) -> tuple[FloatArray, FloatArray, float, float]:
    """Level at rest, then follow the gyros to `time`.

    Returns C_hb, the mean rate at rest (bias and Earth rate together), the time since, and the
    speed change along the nose that the accelerometers saw (its sign tells reversing).
    """
    samples = _samples(stream, *rest)
    mean_rate = stream.gyro[samples].mean(axis=0)
    after = _samples(stream, rest[1], time)
    gravity = np.array([0.0, 0.0, np.linalg.norm(stream.accel[samples].mean(axis=0))])
    dt = np.diff(stream.edges)[after]
    C_hb = np.empty((len(dt) + 1, 3, 3))
    C_hb[0] = _level_at_rest(stream, rest, C_bv)
    for k, turn in enumerate(matrix_from_rotvec((stream.gyro[after] - mean_rate) * dt[:, None])):
        np.matmul(C_hb[k], turn, out=C_hb[k + 1])
    felt_h = np.einsum("kij,kj->ki", C_hb[:-1], stream.accel[after]) + gravity
    moved = float(dt @ np.sum((C_hb[:-1] @ C_bv[:, 0]) * felt_h, axis=1))
    return C_hb[-1], mean_rate, time - rest[1], moved


def _level_in_motion(
    stream: InertialStream, track: VelocityTrack, k: int, course: float, C_bv: FloatArray
) -> FloatArray:
    """Return C_hb at epoch k from specific force and GNSS velocity change around it.

    Over the window the attitude is carried by the gyros, so that turning does not smear it.
    """
    near = np.flatnonzero(np.abs(track.time - track.time[k]) <= 0.5 * LEVEL_WINDOW)
    near = near[(track.time[near] >= stream.start) & (track.time[near] <= stream.end)]
    start, end = float(track.time[near[0]]), float(track.time[near[-1]])
    samples = _samples(stream, start, end)
    if end - start < 1.0 or samples.stop - samples.start < 10:
        raise AlignmentError("cannot level in motion: less than 1 s of IMU data with GNSS velocity")
    C_en = C_en_of(track.pos_e[k])
    dt = np.diff(stream.edges)[samples]
    C_wb = [np.eye(3)]
    for turn in matrix_from_rotvec(stream.gyro[samples] * dt[:, None])[:-1]:
        C_wb.append(C_wb[-1] @ turn)
    at_k = int(np.searchsorted(stream.edges[samples], track.time[k])) - 1
    C_bw = C_wb[max(min(at_k, len(C_wb) - 1), 0)].T
    dv_w = np.einsum("kij,kj,k->i", np.array(C_wb), stream.accel[samples], dt)
    force_b = C_bw @ dv_w / dt.sum()
    accel_n = C_en.T @ (track.vel_e[near[-1]] - track.vel_e[near[0]]) / (end - start)
    force_n = accel_n - C_en.T @ gravity_e(track.pos_e[k])
    force_h = matrix_from_rpy([0.0, 0.0, course]).T @ force_n
    return _level(C_bv.T @ force_b, force_h) @ C_bv.T
