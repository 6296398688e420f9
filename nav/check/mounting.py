"""How the IMU is turned in the vehicle, where GNSS velocities and turns tell its attitude.

An inertial navigation over some minutes that is told nothing of the vehicle finds the IMU's
attitude: level from gravity, heading from turning and changes of speed. Where the vehicle then
goes straight it goes along its own axis, and that direction in IMU axes is the mounting.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np

from ...datasets.observations import GnssFixes
from ...datasets.sequence import Sequence
from ...filters.earth import C_en_of
from ...filters.errors import NavError
from ...filters.levers import rate_over_earth
from ...filters.rotation import FloatArray, matrix_from_rpy, rpy_from_matrix, wrap_angle
from ...velocity.mounting import Mounting, calibrate_mounting
from ...velocity.tracks import Track, tracks
from ..config import AlignmentConfig, Config, FilterConfig, VehicleConfig
from ..engine.model import UNKNOWN
from ..notes import Note
from ..pipeline import navigate
from .axes import AXES, track_turning
from .findings import Finding
from .motion import COURSE_SPEED

#: A check must take well below a second: so much of a drive is looked at [s].
_LONGEST = 300.0
#: And velocities so far apart [s]: a receiver's ten a second tell little more.
_EVERY = 0.5
#: Less turning than this shows no heading [rad].
_TURNING = np.pi / 2
#: Straight driving that a mounting takes: speed [m/s], time [s], and what a course may turn in it,
#: with the noise of velocities [rad/s].
_FAST, _DRIVEN, _STRAIGHT = 5.0, 20.0, np.radians(3.0)
#: What tracks are trusted with: positions, of which only gravity's direction is taken [m], and
#: velocities [m/s].
_SIGMA_POS, _SIGMA_VEL = 50.0, 0.2
#: A mounting known worse than this is not worth a line [rad].
_SIGMA_MOUNTING = np.radians(1.0)
#: Twice what is thought possible of a mounting that nobody has declared: beyond it, it is measured.
_TILTED = 2.0 * UNKNOWN.sigma_mounting
#: Nothing is assumed of the vehicle; course and level are right to what a mounting may be off.
_CONFIG = Config(
    alignment=AlignmentConfig("level+course", sigma_level_deg=5.0, sigma_heading_deg=15.0),
    filter=FilterConfig(smooth=True, output_rate_hz=5.0),
    vehicle=VehicleConfig(nhc="off", zupt=True, odometer="off"),
)


def mounting_findings(sequence: Sequence) -> list[Finding]:
    """Return yaw and pitch of the IMU in the vehicle with their 1σ; nothing where unobservable.

    Parameters
    ----------
    sequence : Sequence
        With an IMU and GNSS whose time, units and axes are in order.
    """
    track = tracks(sequence).gnss
    part = _most_turning(track) if track is not None and track.precise else None
    if part is None:
        return []
    try:
        found, sigma_attitude = _measured(sequence, part)
    except NavError:  # no start, no straight driving: nothing to report
        return []
    sigma_pitch, sigma_yaw = np.hypot([found.sigma_pitch, found.sigma_yaw], sigma_attitude)
    if max(sigma_pitch, sigma_yaw) > _SIGMA_MOUNTING:
        return []
    # As it is declared, the IMU seen from the vehicle, without roll: see `with_roll_of`.
    yaw, pitch = (-np.degrees(angle) for angle in (found.yaw, found.pitch))
    numbers = {
        "yaw_deg": yaw, "yaw_sigma_deg": float(np.degrees(sigma_yaw)),
        "pitch_deg": pitch, "pitch_sigma_deg": float(np.degrees(sigma_pitch)),
        "straight_s": found.straight_s,
    }  # fmt: skip
    text = (
        f"IMU in the vehicle: yaw {yaw:+.2f} ± {numbers['yaw_sigma_deg']:.2f}°, pitch "
        f"{pitch:+.2f} ± {numbers['pitch_sigma_deg']:.2f}° (the direction of motion over "
        f"{found.straight_s:.0f} s of straight driving; attitude from GNSS velocities and turns)"
    )
    return [Finding("note", "mounting", text, numbers=numbers)]


def with_roll_of(C_bv: FloatArray, pitch_deg: float, yaw_deg: float) -> FloatArray:
    """Return roll, pitch, yaw [deg] as declared of a measured forward axis and C_bv's vertical.

    Straight driving shows where forward is, `pitch_deg` and `yaw_deg` without roll. Of an IMU that
    is rolled and turned all three angles are others, by degrees.
    """
    forward_b = matrix_from_rpy(np.radians([0.0, -pitch_deg, -yaw_deg]))[:, 0]
    right_b = np.cross(C_bv[:, 2], forward_b)
    right_b /= np.linalg.norm(right_b)
    found = np.column_stack([forward_b, right_b, np.cross(forward_b, right_b)])
    return np.degrees(rpy_from_matrix(found.T))


def with_coarse_mounting(
    sequence: Sequence, findings: Iterable[Finding]
) -> tuple[Sequence, tuple[Note, ...]]:
    """Return a recording that declares no mounting with a coarse one, where it needs it.

    A run begins with the IMU square in the vehicle to 5° and estimates the rest. An IMU that lies
    or is turned otherwise shows it: the vertical by gravity in the mean of the drive, forward by
    speed and cornering. What is left is as unknown as with any other.

    Parameters
    ----------
    sequence : Sequence
    findings : iterable of Finding
        What was found of it, of which the accelerometer's axes tell forward.

    Returns
    -------
    sequence, notes
    """
    calibration = sequence.calibration
    turned = [f.numbers for f in findings if f.severity == "doubtful" and f.subject == AXES]
    if calibration.mounting_source or sequence.imu is None:
        return sequence, ()
    mean = sequence.imu.accel_b.mean(axis=0)
    down_b = -mean / np.linalg.norm(mean)
    turns = bool(turned) and "turned_deg" in turned[0]
    if down_b[2] > np.cos(_TILTED) and not turns:
        return sequence, ()
    turn, sigma = (turned[0]["turned_deg"], turned[0]["turned_sigma_deg"]) if turns else (0.0, 0.0)
    toward_b = np.array([np.cos(np.radians(turn)), np.sin(np.radians(turn)), 0.0])
    right_b = np.cross(down_b, toward_b)
    right_b /= np.linalg.norm(right_b)
    C_bv = np.column_stack([np.cross(right_b, down_b), right_b, down_b])
    sigma_mounting = float(np.hypot(UNKNOWN.sigma_mounting, np.radians(sigma)))
    roll, pitch, yaw = np.degrees(rpy_from_matrix(C_bv.T))
    text = (
        f"mounting not declared: measured, roll {roll:+.0f}°, pitch {pitch:+.0f}°, yaw {yaw:+.0f}° "
        f"± {np.degrees(sigma_mounting):.0f}° (gravity, speed and cornering), from where it is "
        f"estimated; to declare it: mounting_rpy_deg = [{roll:.0f}, {pitch:.0f}, {yaw:.0f}]"
    )
    calibration = dataclasses.replace(
        calibration, C_bv=C_bv, mounting_source="measured coarsely",
        mounting_sigma=sigma_mounting, lever_vehicle_sigma=UNKNOWN.sigma_wheel,
    )  # fmt: skip
    return dataclasses.replace(sequence, calibration=calibration), (Note("note", text),)


def _most_turning(track: Track) -> Track | None:
    """Return the stretch of the track that turns most; None where it shows nothing."""
    known = np.isfinite(track.vel_n).all(axis=1)
    time = track.time[known]
    if time.size < 20:
        return None
    course = track.course(COURSE_SPEED)[known]
    best, most = slice(0, 0), _TURNING
    for begin in np.arange(time[0], max(time[-1] - _LONGEST, time[0]) + 1.0, 0.2 * _LONGEST):
        part = slice(*np.searchsorted(time, [begin, begin + _LONGEST]))
        turning = track_turning(course[part])
        if turning > most:
            best, most = part, turning
    step = np.diff(time[best])
    rate = np.abs(wrap_angle(np.diff(course[best]))) / step  # NaN where slow: not straight
    straight = (rate < _STRAIGHT) & (track.speed[known][best][1:] > _FAST)
    if step[straight].sum() < _DRIVEN:
        return None
    rows = np.flatnonzero(known)[best]
    rows = rows[:: max(1, round(_EVERY / float(np.median(np.diff(track.time[rows])))))]
    return Track(track.name, track.time[rows], track.pos_e[rows], track.vel_n[rows], track.precise)


def _measured(sequence: Sequence, track: Track) -> tuple[Mounting, FloatArray]:
    """Return the mounting, and 1σ of the attitude it is measured against, pitch and yaw [rad]."""
    n = len(track)
    fixes = GnssFixes(
        track.time,
        track.pos_e,
        np.tile(_SIGMA_POS**2 * np.eye(3), (n, 1, 1)),
        np.einsum("nij,nj->ni", C_en_of(track.pos_e), track.vel_n),
        np.tile(_SIGMA_VEL**2 * np.eye(3), (n, 1, 1)),
        np.full(n, -1),
        np.full(n, track.name),
    )
    alone = dataclasses.replace(
        sequence, imu=sequence.inertial.between(track.time[0] - 1.0, track.time[-1]), fixes=fixes,
        observations=None, navigation=(), odometer=None, reference=None,
    )  # fmt: skip
    solution = navigate(alone, _CONFIG).trajectory
    imu = alone.inertial
    rate = np.column_stack([np.interp(solution.time, imu.time, axis) for axis in imu.gyro_b.T])
    found = calibrate_mounting(
        solution.time,
        solution.vel_e,
        solution.C_eb,
        rate_over_earth(solution.C_eb, rate - solution.gyro_bias),
        lever_b=sequence.calibration.lever_vehicle_b,
        min_speed=_FAST,
    )
    north, east, down = np.sqrt(np.diagonal(solution.cov_att_n, axis1=1, axis2=2)).T
    # Errors of level and heading last: they do not average out over a drive.
    return found, np.array([np.median(np.maximum(north, east)), np.median(down)])
