"""Does the data obey physics? Tests of declared units, axes and time against motion.

Gravity fixes the accelerometer: its mean over a drive is 9.8 m/s² and points up, which in
forward-right-down axes is −z. Turns fix the gyro: its integral about the vertical is the change of
the course, so the slope of one against the other is 1, −1 where the axis is upside down, and 180/π
or π/180 where degrees and radians are mixed up. The vertical is gravity's: an IMU that lies at 30°
in its vehicle measures 13 % less about its own z.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..filters.earth import C_en_of
from ..filters.errors import DataError
from ..filters.rotation import FloatArray
from ..filters.sensors import STANDARD_GRAVITY
from .series import ImuData

#: Below this speed the course of a velocity is noise [m/s].
MIN_COURSE_SPEED = 2.0
#: Turning needed before a gyro is judged [rad].
MIN_TURNED = np.pi / 2
#: How far a slope may be from what it is taken for.
SLOPE_TOLERANCE = 0.10
#: Mean specific force of a drive may be off by bias and mounting [m/s²].
GRAVITY_TOLERANCE = 0.6
#: How far the vertical of a mounted IMU may be from its own z [rad].
LARGEST_TILT = np.radians(30.0)


class Refusal(NamedTuple):
    """What a reader refuses because physics contradicts it.

    Attributes
    ----------
    error : DataError
    against : {'gravity', 'course', 'velocity', 'position'}
        What it was held against.
    """

    error: DataError
    against: str


_collected: ContextVar[list[Refusal] | None] = ContextVar("collected", default=None)


@contextmanager
def collected_refusals() -> Iterator[list[Refusal]]:
    """Collect what readers refuse by physics (`refuse`), instead of raising it.

    For data to be looked at as a whole, or navigated unchecked, although they contradict physics.
    What cannot be read is refused all the same.
    """
    refused: list[Refusal] = []
    token = _collected.set(refused)
    try:
        yield refused
    finally:
        _collected.reset(token)


def refuse(error: DataError, against: str) -> str:
    """Raise the error, or collect it and return it as evidence (`collected_refusals`)."""
    refused = _collected.get()
    if refused is None:
        raise error
    refused.append(Refusal(error, against))
    return str(error)


@dataclass(frozen=True)
class TurnRatio:
    """Gyro against course.

    Attributes
    ----------
    ratio : float
        Slope of the integrated yaw rate against the change of course; NaN without turns.
    sigma : float
        1σ of the slope, with what noise of the course and a lag between the two leave open.
    turned : float
        Sum of the turning it rests on [rad].
    """

    ratio: float
    sigma: float
    turned: float

    @property
    def conclusive(self) -> bool:
        """Whether there is enough turning, and agreement, to judge by."""
        return self.turned >= MIN_TURNED and self.sigma < SLOPE_TOLERANCE / 2 * abs(self.ratio)

    def is_close_to(self, value: float) -> bool:
        """Whether the slope is conclusive and within 10 % of `value`."""
        return self.conclusive and abs(self.ratio / value - 1.0) < SLOPE_TOLERANCE


def course_of(
    pos_e: ArrayLike, vel_e: ArrayLike, min_speed: float = MIN_COURSE_SPEED
) -> FloatArray:
    """Return the course (clockwise from north) of ECEF velocities [rad], shape (n,).

    NaN where the horizontal speed is below `min_speed` [m/s] or the velocity is unknown.
    """
    vel_n = np.einsum("nji,nj->ni", C_en_of(pos_e), np.asarray(vel_e, dtype=float))
    slow = ~(np.hypot(vel_n[:, 0], vel_n[:, 1]) >= min_speed)
    return np.where(slow, np.nan, np.arctan2(vel_n[:, 1], vel_n[:, 0]))


def gyro_unit_ratio(
    imu_time: ArrayLike,
    yaw_rate: ArrayLike,
    course_time: ArrayLike,
    course: ArrayLike,
    *,
    span: float = 3.0,
) -> TurnRatio:
    """Return the slope of the integrated yaw rate against the change of course or heading.

    Parameters
    ----------
    imu_time : array_like, shape (n,)
        [s].
    yaw_rate : array_like, shape (n,)
        Rate about the down axis, in the unit under test; mean over the preceding interval.
    course_time, course : array_like, shape (m,)
        [s], [rad], clockwise from north; NaN where unknown (standing, reversing starts).
    span : float
        Both are compared over intervals of this length [s]: long against the time by which an
        antenna's course leads the body's heading, short against the drift of a gyro bias.

    Returns
    -------
    TurnRatio
        An intercept (the gyro bias times `span`) is estimated and discarded.
    """
    t, w = np.asarray(imu_time, dtype=float), np.asarray(yaw_rate, dtype=float)
    tc, c = np.asarray(course_time, dtype=float), np.asarray(course, dtype=float)
    inside = (tc >= t[0]) & (tc <= t[-1])
    tc, c = tc[inside], c[inside]
    if tc.size < 3:
        return TurnRatio(np.nan, np.inf, 0.0)
    step = int(np.clip(np.rint(span / float(np.median(np.diff(tc)))), 1, tc.size))
    if step >= tc.size:
        return TurnRatio(np.nan, np.inf, 0.0)
    angle = np.concatenate([[0.0], np.cumsum(w[1:] * np.diff(t))])
    turn = _increments(c, step)
    length = np.full(turn.size, np.nan)
    length[: tc.size - step] = tc[step:] - tc[:-step]
    good = np.isfinite(turn) & (length < 1.5 * step * float(np.median(np.diff(tc))))
    stride = max(1, step // 2)  # overlapping by half: closer neighbours say the same
    k = np.flatnonzero(good)[::stride]
    if k.size < 4:
        return TurnRatio(np.nan, np.inf, 0.0)
    x = turn[k]
    y = np.interp(tc[k + step], t, angle) - np.interp(tc[k], t, angle)
    return _robust_slope(x, y, overlap=step / stride)


def _increments(course: FloatArray, step: int) -> FloatArray:
    """Return course[k + step] − course[k], followed through every sample between; NaN if broken."""
    change = np.diff(course)
    change = (change + np.pi) % (2.0 * np.pi) - np.pi
    known = np.isfinite(change)
    total = np.concatenate([[0.0], np.cumsum(np.where(known, change, 0.0))])
    broken = np.concatenate([[0], np.cumsum(~known)])
    out = np.full(course.size, np.nan)
    if step < course.size:
        clean = broken[step:] == broken[:-step]
        out[: course.size - step][clean] = (total[step:] - total[:-step])[clean]
    return out


def _robust_slope(x: FloatArray, y: FloatArray, overlap: float) -> TurnRatio:
    """Fit y = a + b·x without the outliers that reversing puts into the course.

    The course x is noisy and may lead or lag, the gyro's y is clean over some seconds: noise makes
    sd(y)/sd(x) too small, whatever the lag, and a lag makes var(y)/cov(x, y) too large, whatever
    the noise. The slope lies between the two: σ counts it as anywhere there. (Least squares of y
    on x suffers from both, and is below either.)

    The start is a weighted median of the slopes towards the centre, which an outlier in x cannot
    move. What is then off by more than 4 robust σ and a fifth of the turn that the gyro tells is
    left out: σ alone is that of the straights, and would leave out the turns, and a course that
    jumps tells of turns that are none.
    """
    from_centre = x - np.median(x)
    weight = np.abs(from_centre)
    if weight.sum() == 0.0:
        return TurnRatio(np.nan, np.inf, 0.0)
    far = weight > 0.0
    slope = (y - np.median(y))[far] / from_centre[far]
    order = np.argsort(slope)
    share = np.cumsum(weight[far][order])
    b = float(slope[order][np.searchsorted(share, 0.5 * share[-1])])
    residual = y - b * x
    residual = residual - np.median(residual)
    scale = 1.4826 * float(np.median(np.abs(residual)))
    told = np.abs(y - np.median(y))
    keep = np.abs(residual) <= 4.0 * scale + 0.2 * told + 1e-9 * (1.0 + np.abs(y).max())
    x, y = x[keep], y[keep]
    turned = float(np.abs(x).sum() / overlap)
    x, y = x - x.mean(), y - y.mean()
    xx, xy, yy = float(x @ x), float(x @ y), float(y @ y)
    if x.size < 4 or xx == 0.0 or xy == 0.0:
        return TurnRatio(np.nan, np.inf, turned)
    least, most = float(np.copysign(np.sqrt(yy / xx), xy)), yy / xy
    residual = x - xy / yy * y
    chance = abs(most) * np.sqrt(float(residual @ residual) / (x.size - 2) / yy) * abs(most)
    between = abs(most - least) / np.sqrt(12.0)  # of what is anywhere between them
    return TurnRatio(0.5 * (least + most), float(np.hypot(chance, between)), turned)


def vertical_rate(imu: ImuData) -> FloatArray:
    """Return the rate about the vertical of an IMU, however it lies in its vehicle, shape (n,).

    Down is the body axis that gravity makes it, on average, on the side of z: whatever is declared
    upside down stays so. Where that is no vertical, forces being wrong, z itself counts.
    """
    mean = imu.accel_b.mean(axis=0)
    size = float(np.linalg.norm(mean))
    lean = abs(mean[2]) / size if size > 0.0 else 0.0
    if lean < np.cos(LARGEST_TILT):
        return imu.gyro_b[:, 2]
    rate: FloatArray = imu.gyro_b @ (mean / np.copysign(size, mean[2]))
    return rate


def decide_gyro_unit(ratio: TurnRatio, *, file: str | Path) -> tuple[str, str]:
    """Return 'deg/s' or 'rad/s' for a gyro whose numbers were integrated as if in rad/s.

    Parameters
    ----------
    ratio : TurnRatio
        Of the unconverted numbers about the down axis.
    file : path
        The file under test, for the message.

    Returns
    -------
    unit, evidence : str

    Raises
    ------
    DataError
        When there is too little turning, when the slope fits neither unit within 10 %, or when
        its sign says that the axis points the other way.
    """
    for unit, value in (("rad/s", 1.0), ("deg/s", 180.0 / np.pi)):
        if ratio.is_close_to(value):
            slope = ratio.ratio / value
            turned = np.degrees(ratio.turned)
            return unit, (
                f"gyro unit {unit}: integrated yaw rate / course change = {slope:.3f} "
                f"± {ratio.sigma / value:.3f} over {turned:.0f}° of turning"
            )
        if ratio.is_close_to(-value):
            problem = (
                f"yaw rate has the wrong sign: in {unit} its integral is "
                f"{ratio.ratio / value:.2f} times the course change"
            )
            remedy = "declare the axes (z up or down) the file really holds"
            return unit, refuse(DataError(problem, file=file, remedy=remedy), "course")
    short = ratio.turned < MIN_TURNED
    raise DataError(
        "gyro unit cannot be told: integral / course change is "
        f"{ratio.ratio:.3g} ± {ratio.sigma:.2g} over {np.degrees(ratio.turned):.0f}° of turning, "
        "expected 1 (rad/s) or 57.3 (deg/s) within 10 %"
        + (f" over {np.degrees(MIN_TURNED):.0f}° at least" if short else ""),
        file=file,
        remedy="declare gyro_unit='deg/s' or 'rad/s'",
    )


def check_gyro(
    imu: ImuData, course_time: ArrayLike, course: ArrayLike, *, file: str | Path, declared: str
) -> str:
    """Verify unit and sign of the yaw gyro against the course, and return the evidence.

    Parameters
    ----------
    imu : ImuData
        Converted as declared.
    course_time, course : array_like, shape (m,)
        [s], [rad]; NaN where unknown.
    file : path
    declared : str
        What was declared, for the message: 'deg/s, RFU'.

    Raises
    ------
    DataError
        When the drive turns enough to tell, and contradicts the declaration.
    """
    found = gyro_unit_ratio(imu.time, vertical_rate(imu), course_time, course)
    evidence = f"integrated yaw rate / course change = {found.ratio:.3g} ± {found.sigma:.1g}"
    if not found.conclusive:
        return f"gyro {declared}: taken as declared, too little turning to verify"
    if found.is_close_to(1.0):
        return f"gyro {declared}: verified, {evidence} over {np.degrees(found.turned):.0f}°"
    if found.ratio < 0:
        remedy = "the yaw axis is upside down: correct the declared axes"
    elif found.is_close_to(180.0 / np.pi):
        remedy = "the file is in deg/s: declare gyro_unit='deg/s'"
    elif found.is_close_to(np.pi / 180.0):
        remedy = "the file is in rad/s: declare gyro_unit='rad/s'"
    else:
        remedy = "check the gyro's unit, axes and time scale"
    return refuse(
        DataError(
            f"gyro declared {declared} contradicts the course: {evidence}, expected 1",
            file=file,
            remedy=remedy,
        ),
        "course",
    )


def check_gravity(accel_b: ArrayLike, *, file: str | Path, declared: str) -> str:
    """Verify unit and up-axis of the accelerometer against gravity, and return the evidence.

    Parameters
    ----------
    accel_b : array_like, shape (n, 3)
        Specific force converted as declared: m/s², forward-right-down.
    file : path
    declared : str
        What was declared, for the message: 'm/s², RFU'.

    Raises
    ------
    DataError
        When the mean is not 9.8 ± 0.6 m/s² or does not point up (−z) within 30°.
    """
    mean = np.asarray(accel_b, dtype=float).mean(axis=0)
    size = float(np.linalg.norm(mean))
    if abs(size - STANDARD_GRAVITY) > GRAVITY_TOLERANCE:
        in_g, doubled = size * STANDARD_GRAVITY, size / STANDARD_GRAVITY
        if abs(in_g - STANDARD_GRAVITY) < GRAVITY_TOLERANCE:
            remedy = "the file is in g: declare accel_unit='g'"
        elif abs(doubled - STANDARD_GRAVITY) < GRAVITY_TOLERANCE:
            remedy = "the file is in m/s²: declare accel_unit='m/s2'"
        else:
            remedy = "check unit, and whether the file holds increments instead of rates"
        return refuse(
            DataError(
                f"accelerometer declared {declared}: expected a mean of 9.8 m/s², found {size:.2f}",
                file=file,
                remedy=remedy,
            ),
            "gravity",
        )
    if -mean[2] < size * np.cos(LARGEST_TILT):
        axis = int(np.argmax(np.abs(mean)))
        sign = "+" if mean[axis] > 0 else "−"
        return refuse(
            DataError(
                f"accelerometer declared {declared}: expected up = −z after conversion to "
                f"forward-right-down, found {sign}{'xyz'[axis]} ({mean.round(2)} m/s²)",
                file=file,
                remedy="declare the axes the file really holds",
            ),
            "gravity",
        )
    tilt = np.degrees(np.arccos(np.clip(-mean[2] / size, -1.0, 1.0)))
    return (
        f"accelerometer {declared}: verified, mean {size:.3f} m/s², {tilt:.1f}° from the down axis"
    )
