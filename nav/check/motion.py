"""The IMU against the motion GNSS sees: time first, then axes, signs and units.

Time is found whatever the axes are (`nav.check.lag`), and taken out before axes are judged: so one
fault makes one finding. The gyro's integral is the change of course; the accelerometer's is the
change of speed along, and speed times change of course across. Course is that of the antenna,
which sits ahead of the rear axle and therefore leads the heading by their distance over speed:
0.1–0.3 s in a car, which is a limit of the gyro as a clock and not a fault.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ...datasets.physics import gyro_unit_ratio
from ...datasets.sequence import Sequence
from ...filters.rotation import FloatArray
from ...velocity.tracks import Track
from .findings import Finding
from .lag import Fit, Lag, find_lag, fit_increments

#: Slower than this, a course is no direction to compare with [m/s].
COURSE_SPEED = 3.0
#: Intervals over which motion is compared [s]: short against a manoeuvre.
_INTERVAL = 1.0
#: No car accelerates faster: an increment that does is an outlier of the GNSS [m/s²].
_MAX_ACCELERATION = 12.0
#: Offsets below are neither told from filter delays inside receivers nor worth a doubt [s].
LAG_TOLERANCE = 0.04
#: From here on a position is metres off: not navigable [s].
LAG_FATAL = 0.5
#: Distance between antenna and rear axle, and what remains unknown of a lever arm [m].
_AXLE, _LEVER = 2.0, 0.3
#: Share of a motion an accelerometer has to explain before its axes are judged.
_EXPLAINED = 0.4
#: And before what it says is fatal.
_CERTAIN = 0.7
_DEGREES = 180.0 / np.pi
_AXES = "xyz"


@dataclass(frozen=True, eq=False)
class Inertial:
    """IMU integrals in vehicle axes (mounting applied).

    Attributes
    ----------
    time : ndarray, shape (n,)
    angle, velocity : ndarray, shape (n, 3)
        ∫ω [rad] and ∫f [m/s], vehicle axes.
    gyro : ndarray, shape (n, 3)
        [rad/s].
    """

    time: FloatArray
    angle: FloatArray
    velocity: FloatArray
    gyro: FloatArray

    def shifted(self, seconds: float) -> Inertial:
        """Return the same with `seconds` added to the stamps."""
        return Inertial(self.time + seconds, self.angle, self.velocity, self.gyro)


@dataclass(frozen=True)
class Offset:
    """A time offset from all motions that show it.

    Attributes
    ----------
    lag, sigma : float
        Positive: the IMU's stamps are late [s].
    evidence : tuple of (str, Lag)
    """

    lag: float
    sigma: float
    evidence: tuple[tuple[str, Lag], ...]

    @property
    def significant(self) -> bool:
        """Whether the offset is beyond its uncertainty and what receivers do to time."""
        return abs(self.lag) > LAG_TOLERANCE + 3.0 * self.sigma


def inertial(sequence: Sequence) -> Inertial:
    """Return the IMU's integrals in vehicle axes."""
    imu, C_bv = sequence.inertial, sequence.calibration.C_bv
    step = np.diff(imu.time, prepend=imu.time[0])[:, None]
    gyro, accel = imu.gyro_b @ C_bv, imu.accel_b @ C_bv
    return Inertial(imu.time, np.cumsum(gyro * step, axis=0), np.cumsum(accel * step, axis=0), gyro)


@dataclass(frozen=True, eq=False)
class Increments:
    """Motion of a track over intervals of about a second, shape (m,) each; NaN where unknown."""

    start: FloatArray
    end: FloatArray
    along: FloatArray
    across: FloatArray
    turn: FloatArray
    turning_speed: float


def increments(track: Track, heading: FloatArray | None = None) -> Increments | None:
    """Return changes of speed [m/s], speed × change of course [m/s] and of course [rad].

    `heading` replaces the course in the last, where it is known.
    """
    known = np.isfinite(track.vel_n).all(axis=1)
    if known.sum() < 10:
        return None
    time, vel = track.time[known], track.vel_n[known]
    heading = None if heading is None or not np.isfinite(heading).any() else heading[known]
    step = max(1, round(_INTERVAL / float(np.median(np.diff(time)))))
    start, end = time[:-step], time[step:]
    speed = np.hypot(vel[:, 0], vel[:, 1])
    course = np.arctan2(vel[:, 1], vel[:, 0])
    along = speed[step:] - speed[:-step]
    turn = _wrapped(course[step:] - course[:-step])
    across = 0.5 * (speed[step:] + speed[:-step]) * turn
    span = end - start
    whole = span < 1.5 * max(_INTERVAL, float(np.median(span)))
    sane = whole & (np.hypot(along, across) < _MAX_ACCELERATION * span)
    # Antennas that pass zero speed turn their course by 180°.
    fast = sane & (np.minimum(speed[step:], speed[:-step]) > COURSE_SPEED)
    if heading is not None:
        turn = _wrapped(heading[step:] - heading[:-step])
    yaw = whole if heading is not None else fast
    turning = np.abs(turn[fast]) > 0.05
    return Increments(
        start,
        end,
        np.where(sane, along, np.nan),
        np.where(fast, across, np.nan),
        np.where(yaw, turn, np.nan),
        float(np.median((speed[step:])[fast][turning])) if turning.any() else np.nan,
    )


def _wrapped(angle: FloatArray) -> FloatArray:
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def time_offset(
    imu: Inertial, track: Track, distance: float, heading: FloatArray | None = None
) -> Offset | None:
    """Return by how much the IMU's stamps are late against a track, or None if nothing tells.

    Parameters
    ----------
    imu : Inertial
    track : Track
    distance : float
        From the IMU to the point the track is of [m]: its acceleration leads or lags cornering.
    heading : ndarray, shape (n,), optional
        Heading of the body at the track's times [rad]; the course otherwise.
    """
    moves = increments(track, heading)
    if moves is None:
        return None
    speed = moves.turning_speed if np.isfinite(moves.turning_speed) else COURSE_SPEED
    horizontal = imu.velocity[:, :2]
    found = []
    for what, integral, y, systematic in (
        ("speed", horizontal, moves.along, 0.01),
        ("cornering", horizontal, moves.across, (distance + _LEVER) / speed),
        ("turn rate", imu.angle, moves.turn, 0.01 if heading is not None else _AXLE / speed),
    ):
        lag = find_lag(imu.time, integral, moves.start, moves.end, y[:, None])
        if lag is not None and lag.conclusive:
            found.append((what, lag, float(np.hypot(lag.sigma, systematic))))
    if not found:
        return None
    # A far lag is taken from the motion that shows it best; those that contradict it are left out.
    best = max(found, key=lambda f: f[1].explained)
    near = [f for f in found if abs(f[1].lag - best[1].lag) < 1.0]
    weight = np.array([1.0 / f[2] ** 2 for f in near])
    mean = float(weight @ [f[1].lag for f in near] / weight.sum())
    return Offset(mean, float(weight.sum() ** -0.5), tuple((f[0], f[1]) for f in near))


def offset_findings(offset: Offset | None, other: str) -> list[Finding]:
    """Return what the IMU's time offset against `other` ('GNSS') means."""
    subject = f"time, IMU and {other}"
    if offset is None:
        return [
            Finding(
                "note", subject, "an offset cannot be told: too little acceleration and turning"
            )
        ]
    size, late = abs(offset.lag), "late" if offset.lag > 0 else "early"
    evidence = ", ".join(f"{what} {lag.lag:+.2f} s" for what, lag in offset.evidence)
    numbers = {"offset_s": offset.lag, "offset_sigma_s": offset.sigma}
    if not offset.significant:
        return [
            Finding(
                "note",
                subject,
                f"agree to {offset.lag:+.3f} ± {offset.sigma:.3f} s ({evidence})",
                numbers=numbers,
            )
        ]
    found = f"the IMU's stamps are {size:.2f} ± {offset.sigma:.2f} s {late} ({evidence})"
    change = ("subtract", "from") if offset.lag > 0 else ("add", "to")
    remedy = f"{change[0]} {size:.2f} s {change[1]} the IMU's time"
    if size < LAG_FATAL:
        found += f"; at 20 m/s that is {20.0 * size:.0f} m along the road"
        return [Finding("doubtful", subject, found, remedy, numbers)]
    leap = leap_second_words(offset.lag)
    return [Finding("fatal", subject, found + leap, leap_remedy(offset.lag, remedy), numbers)]


def leap_second_words(lag: float) -> str:
    """Return what a lag that equals GPS − UTC suggests, or ''."""
    n = round(abs(lag))
    if abs(abs(lag) - n) > 0.3 or n not in (*range(13, 19), 36):
        return ""
    return f", the leap seconds between UTC and GPS time{' applied twice' if n == 36 else ''}"


def leap_remedy(lag: float, otherwise: str) -> str:
    """Return how to declare a leap-second slip, or `otherwise`."""
    if not leap_second_words(lag):
        return otherwise
    which = "the IMU is in UTC" if lag < 0 else "the GNSS is in UTC"
    return f"declare the time scale: it looks as if {which} while the other is in GPS time"


def gyro(imu: Inertial, track: Track) -> list[Finding]:
    """Test which axis carries the yaw rate, its sign and its unit, against the course."""
    course = track.course(COURSE_SPEED)
    ratios = [gyro_unit_ratio(imu.time, imu.gyro[:, k], track.time, course) for k in range(3)]
    down = ratios[2]
    turned = float(np.degrees(down.turned))
    numbers = {"yaw_over_course": down.ratio, "sigma": down.sigma, "turned_deg": turned}
    evidence = f"integrated z rate / course change = {down.ratio:.3g} ± {down.sigma:.1g}"
    if down.is_close_to(1.0):
        found = f"z is the yaw rate, in rad/s, clockwise positive ({evidence} over {turned:.0f}°)"
        return [Finding("note", "gyro", found, numbers=numbers)]
    enough = track_turning(course)
    if enough < np.pi / 2:
        found = f"unit, axis and sign cannot be told: only {np.degrees(enough):.0f}° of turning"
        return [Finding("note", "gyro", found, numbers=numbers)]
    for k in (2, 0, 1):
        for size, unit in ((1.0, ""), (_DEGREES, "deg/s"), (1.0 / _DEGREES, "rad/s")):
            for sign in (1.0, -1.0):
                if ratios[k].is_close_to(sign * size):
                    return [_gyro_fault(k, sign, unit, ratios[k].ratio, numbers)]
    if not down.conclusive:
        if abs(down.ratio - 1.0) < 0.25 and down.sigma < 0.1:
            found = f"z follows the course, not enough to verify its scale ({evidence})"
            return [Finding("note", "gyro", found, numbers=numbers)]
        found = (
            f"no axis follows the course over {np.degrees(enough):.0f}° of turning (z: {evidence})"
        )
        return [
            Finding("doubtful", "gyro", found, "check the gyro's columns and its time", numbers)
        ]
    off = abs(down.ratio - 1.0)
    found = f"scale off by {100 * (down.ratio - 1):+.0f} %: {evidence} over {turned:.0f}°"
    return [
        Finding(
            "doubtful" if off < 0.5 else "fatal", "gyro", found,
            "check the gyro's unit and scale factor", numbers,
        )
    ]  # fmt: skip


def track_turning(course: FloatArray) -> float:
    """Return the sum of course changes over 3 s and more [rad], noise of single epochs left out."""
    known = course[np.isfinite(course)]
    if known.size < 20:
        return 0.0
    smooth = np.unwrap(known)[:: max(1, known.size // 100)]
    change = np.abs(np.diff(smooth))
    return float(change[(change > 0.1) & (change < 2.5)].sum())


def _gyro_fault(
    axis: int, sign: float, unit: str, ratio: float, numbers: dict[str, float]
) -> Finding:
    parts, remedies = [], []
    if axis != 2:
        parts.append(f"the yaw rate is on axis {_AXES[axis]}, not on z: axes are swapped")
    if sign < 0:
        parts.append("its sign is reversed: turning right must be positive about z down")
    if parts:
        remedies.append("the axes the file really holds")
    if unit:
        parts.append(f"the file's unit is {unit}, not the declared one (factor {abs(ratio):.3g})")
        remedies.append(f"the gyro's unit as {unit}")
    return Finding("fatal", "gyro", "; ".join(parts), "declare " + " and ".join(remedies), numbers)


def accelerometer(imu: Inertial, track: Track) -> list[Finding]:
    """Test forward and right axes against changes of speed and cornering."""
    moves = increments(track)
    if moves is None:
        return []
    horizontal = imu.velocity[:, :2]
    fits = [
        fit_increments(imu.time, horizontal, moves.start, moves.end, y)
        for y in (moves.along, moves.across)
    ]
    # GNSS = B · accelerometer; identity when the axes are forward and right.
    known = [fit.explained > _EXPLAINED for fit in fits]
    subject = "accelerometer axes"
    if not any(known):
        found = "forward and right cannot be told: too little acceleration and cornering"
        return [Finding("note", subject, found)]
    if all(known):
        return [_plane(fits)]
    which = 0 if known[0] else 1
    fit, motion, name = fits[which], ("speed", "cornering")[which], ("forward", "right")[which]
    # Without the other motion its axis may have felt nothing: the direction of the response tells.
    along, across = (fit.response[which], (1, -1)[which] * fit.response[1 - which])
    gain = float(np.hypot(along, across))
    sigma_deg = float(np.degrees(fit.response_sigma[1 - which] / gain))
    turn = float(np.degrees(np.arctan2(across, along)))
    judged = _turned(turn, sigma_deg, gain, f"from {motion} alone", name)
    # Turned axes would show in both motions: one alone is poor data before it is a fault.
    if judged.severity == "fatal":
        judged = dataclasses.replace(judged, severity="doubtful")
    return [judged]


def _plane(fits: list[Fit]) -> Finding:
    """Judge the whole horizontal plane: a rotation, or a mirror image of one."""
    B = np.array([fit.coefficients for fit in fits])
    share = ", ".join(f"{100 * fit.explained:.0f} %" for fit in fits)
    proper = np.hypot(B[0, 0] + B[1, 1], B[0, 1] - B[1, 0]) / 2.0
    mirrored = np.hypot(B[0, 0] - B[1, 1], B[0, 1] + B[1, 0]) / 2.0
    if mirrored > proper:
        axis = "right" if B[0, 0] > abs(B[0, 1]) else "forward" if B[1, 1] > abs(B[1, 0]) else ""
        how = f"the {axis} axis is reversed" if axis else "forward and right are swapped"
        return Finding(
            "fatal" if min(fit.explained for fit in fits) > _CERTAIN else "doubtful",
            "accelerometer axes",
            f"left-handed: {how} (speed and cornering against accelerometer, {share} explained)",
            "declare the axes the file really holds: a rotation cannot mend a mirrored set",
            {"forward_from_x": B[0, 0], "forward_from_y": B[0, 1],
             "right_from_x": B[1, 0], "right_from_y": B[1, 1]},
        )  # fmt: skip
    turn = float(np.degrees(np.arctan2(B[0, 1] - B[1, 0], B[0, 0] + B[1, 1])))
    sigma_deg = float(np.degrees(np.hypot(fits[0].sigma[1], fits[1].sigma[0]) / (2.0 * proper)))
    how = f"from speed and cornering, {share} explained"
    found = _turned(turn, sigma_deg, float(proper), how, "forward")
    if found.severity == "fatal" and min(fit.explained for fit in fits) < _CERTAIN:
        return dataclasses.replace(found, severity="doubtful")
    return found


def _turned(turn_deg: float, sigma_deg: float, gain: float, how: str, name: str) -> Finding:
    numbers = {"turned_deg": turn_deg, "turned_sigma_deg": sigma_deg, "gain": gain}
    subject = "accelerometer axes"
    if abs(turn_deg) > 20.0 + 3.0 * sigma_deg:
        side = "right" if turn_deg > 0 else "left"
        quarter = round(turn_deg / 90.0) * 90
        found = f"the vehicle's {name} direction lies {abs(turn_deg):.0f}° to the {side} ({how})"
        if abs(turn_deg) > 135.0:
            found = f"x points backward: the vehicle moves along −x ({how})"
        near = abs(turn_deg - quarter) < 20.0 and quarter
        remedy = (
            "declare the axes the file really holds"
            if near
            else f"declare the mounting: yaw {turn_deg:+.0f}°"
        )
        severity = "fatal" if abs(turn_deg) > 45.0 else "doubtful"
        return Finding(severity, subject, found, remedy, numbers)
    if not 0.4 < gain < 1.8:
        found = f"gain {gain:.3g} against the GNSS, expected about 1 ({how})"
        return Finding("doubtful", subject, found, "check the accelerometer's unit", numbers)
    angle = f"{turn_deg:+.0f} ± {sigma_deg:.0f}°"
    found = f"x forward, y right, turned by {angle}, gain {gain:.2f} ({how})"
    return Finding("note", subject, found, numbers=numbers)


def odometer(sequence: Sequence, track: Track) -> list[Finding]:
    """Test the odometer's speed against the GNSS's: unit and scale."""
    data = sequence.odometer
    if data is None:
        return []
    known = np.isfinite(track.vel_n).all(axis=1) & (track.speed > COURSE_SPEED)
    known &= (track.time > data.time[0]) & (track.time < data.time[-1])
    if known.sum() < 20:
        return [Finding("note", "odometer", "too little common motion to compare it with GNSS")]
    speed = np.interp(track.time[known], data.time, data.speed)
    scale = float(np.median(speed / track.speed[known]))
    found = f"speed is {scale:.3f} times that of the GNSS (median)"
    numbers = {"scale": scale}
    if abs(scale - 1.0) < 0.05:
        return [Finding("note", "odometer", found, numbers=numbers)]
    for factor, words in ((3.6, "in km/h"), (-1.0, "negative when driving forward")):
        if abs(scale / factor - 1.0) < 0.05:
            return [Finding("doubtful", "odometer", f"{found}: {words}", "declare it", numbers)]
    return [Finding("doubtful", "odometer", found, "check its unit and scale", numbers)]
