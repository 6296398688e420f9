"""Axes, signs and units of the IMU and the odometer against the motion GNSS sees."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...datasets.physics import gyro_unit_ratio
from ...datasets.sequence import Sequence
from ...filters.rotation import FloatArray, rpy_from_matrix
from ...velocity.tracks import Track
from ...velocity.wheel_speed import wheel_speed
from .findings import Finding
from .motion import COURSE_SPEED, Inertial, increments
from .orientation import CERTAIN, Facing, facing, orientation

_DEGREES = 180.0 / np.pi
_AXES = "xyz"
#: What findings on forward and right are about.
AXES = "accelerometer axes"


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
    if increments(track) is None:
        return []
    found = facing(imu, track)
    if found is None:
        text = "forward and right cannot be told: too little acceleration and cornering"
        return [Finding("note", AXES, text)]
    if found.mirrored:
        return [_mirrored(found)]
    judged = _turned(found)
    # Turned axes would show in both motions: one alone is poor data before it is a fault.
    certain = len(found.motions) == 2 and min(found.explained) > CERTAIN
    if judged.severity == "fatal" and not certain:
        judged = dataclasses.replace(judged, severity="doubtful")
    return [judged]


def _mirrored(found: Facing) -> Finding:
    """Judge a horizontal plane that no rotation explains."""
    B = found.B
    axis = "right" if B[0, 0] > abs(B[0, 1]) else "forward" if B[1, 1] > abs(B[1, 0]) else ""
    how = f"the {axis} axis is reversed" if axis else "forward and right are swapped"
    share = ", ".join(f"{100 * part:.0f} %" for part in found.explained)
    return Finding(
        "fatal" if min(found.explained) > CERTAIN else "doubtful",
        AXES,
        f"left-handed: {how} (speed and cornering against accelerometer, {share} explained)",
        "declare the axes the file really holds: a rotation cannot mend a mirrored set",
        {"forward_from_x": B[0, 0], "forward_from_y": B[0, 1],
         "right_from_x": B[1, 0], "right_from_y": B[1, 1]},
    )  # fmt: skip


def _turned(found: Facing) -> Finding:
    turn_deg, sigma_deg = float(np.degrees(found.turn)), float(np.degrees(found.sigma))
    gain, how = found.gain, found.how
    name = "right" if found.motions == ("cornering",) else "forward"
    if len(found.motions) == 2:
        how += " explained"
    numbers = {"turned_deg": turn_deg, "turned_sigma_deg": sigma_deg, "gain": gain}
    if abs(turn_deg) > 20.0 + 3.0 * sigma_deg:
        side = "right" if turn_deg > 0 else "left"
        quarter = round(turn_deg / 90.0) * 90
        text = f"the vehicle's {name} direction lies {abs(turn_deg):.0f}° to the {side} ({how})"
        if abs(turn_deg) > 135.0:
            text = f"x points backward: the vehicle moves along −x ({how})"
        near = abs(turn_deg - quarter) < 20.0 and quarter
        # A vehicle whose forward lies to the left has its IMU turned to the right.
        mounting = f"mounting_rpy_deg = [0.0, 0.0, {-turn_deg:.1f}]"
        remedy = f"declare the mounting: {mounting}"
        if near:
            remedy = f"declare the axes the file really holds, or {mounting}"
        severity = "fatal" if abs(turn_deg) > 45.0 else "doubtful"
        return Finding(severity, AXES, text, remedy, numbers)
    if not 0.4 < gain < 1.8:
        text = f"gain {gain:.3g} against the GNSS, expected about 1 ({how})"
        return Finding("doubtful", AXES, text, "check the accelerometer's unit", numbers)
    angle = f"{turn_deg:+.0f} ± {sigma_deg:.0f}°"
    text = f"x forward, y right, turned by {angle}, gain {gain:.2f} ({how})"
    return Finding("note", AXES, text, numbers=numbers)


def as_it_is(imu: Inertial, track: Track) -> list[Finding]:
    """Return how the body axes are really turned, where gravity and motion tell all of it.

    For what was declared otherwise; `nav.check.declarations` makes lines of it.
    """
    found = orientation(imu, track)
    if found.problem:
        return []
    roll, pitch, yaw = np.degrees(rpy_from_matrix(found.C_sv.T))
    numbers = {
        "roll_deg": float(roll), "pitch_deg": float(pitch), "yaw_deg": float(yaw),
        "sigma_deg": float(np.degrees(found.sigma)),
    }  # fmt: skip
    if found.rate.conclusive:
        numbers["yaw_over_course"] = found.rate.ratio
    return [Finding("note", "orientation", f"measured: {found.share}", numbers=numbers)]


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
    moving = np.isfinite(track.vel_n).all(axis=1)
    wheels = wheel_speed(data.time, data.speed, track.time[moving], track.speed[moving])
    if wheels is not None:
        late = "late" if wheels.delay >= 0.0 else "early"
        found += f", stamps {late} by {abs(wheels.delay):.3f} ± {wheels.delay_sigma:.3f} s"
        numbers["delay"] = wheels.delay
    if abs(scale - 1.0) < 0.05:
        return [Finding("note", "odometer", found, numbers=numbers)]
    for factor, words in ((3.6, "in km/h"), (-1.0, "negative when driving forward")):
        if abs(scale / factor - 1.0) < 0.05:
            return [Finding("doubtful", "odometer", f"{found}: {words}", "declare it", numbers)]
    return [Finding("doubtful", "odometer", found, "check its unit and scale", numbers)]
