"""How an IMU is turned in its vehicle, from gravity, speed and turns alone; and its gyro's unit.

The mean specific force of a drive points up. Changes of speed then tell forward in the level plane,
and cornering right: together also whether the axes are right-handed. Where speed alone or cornering
alone is felt, the direction of the response tells. The rate about down against the course tells the
gyro's unit, and once more the handedness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...datasets.axes import all_axes, axes_name
from ...datasets.physics import TurnRatio, gyro_unit_ratio
from ...filters.rotation import FloatArray, matrix_from_rpy, rpy_from_matrix, wrap_angle
from ...velocity.tracks import Track
from .lag import Fit, fit_increments
from .motion import COURSE_SPEED, Inertial, increments

#: Share of a motion an accelerometer has to explain before its axes are judged.
EXPLAINED = 0.4
#: And before what it says is beyond doubt.
CERTAIN = 0.7
#: 1σ within which forward has to be known before it is named [rad]: a third of what lies between
#: two neighbouring axes and the middle between them.
_SURE = np.radians(10.0)
#: Gain of the accelerometer against GNSS that a right unit and a right clock have.
_GAIN = (0.6, 1.6)
#: An IMU so nearly square in its vehicle is called so: with what a run begins, 1σ [deg].
SQUARE_DEG = 5.0
#: What cars leave open of level and forward: roads that slope, and side slip [rad].
_LEVEL, _SLIP = np.radians(1.5), np.radians(1.5)


@dataclass(frozen=True, eq=False)
class Facing:
    """Where forward lies in level axes, x ahead and y to the right if they are a vehicle's.

    Attributes
    ----------
    turn : float
        Direction of forward, clockwise from x [rad].
    sigma : float
        1σ [rad].
    gain : float
        Increments of the GNSS over those of the accelerometer.
    mirrored : bool
        Whether no rotation but a mirror image of one explains speed and cornering.
    explained : tuple of float
        Shares of speed and cornering.
    B : ndarray, shape (2, 2)
        (along, across) = B (x, y).
    """

    turn: float
    sigma: float
    gain: float
    mirrored: bool
    explained: tuple[float, float]
    B: FloatArray

    @property
    def disagreement(self) -> float:
        """Angle between what speed and cornering say by themselves [rad]; 0 with one of them."""
        if len(self.motions) < 2:
            return 0.0
        by_speed = np.arctan2(self.B[0, 1], self.B[0, 0])
        by_cornering = np.arctan2(-self.B[1, 0], self.B[1, 1])
        return float(abs(wrap_angle(by_speed - by_cornering)))

    @property
    def motions(self) -> tuple[str, ...]:
        """The motions it rests on."""
        pairs = zip(("speed", "cornering"), self.explained, strict=True)
        return tuple(name for name, share in pairs if share > EXPLAINED)

    @property
    def how(self) -> str:
        """The evidence in words."""
        if len(self.motions) == 1:
            return f"from {self.motions[0]} alone"
        return "from speed and cornering, " + ", ".join(f"{100 * s:.0f} %" for s in self.explained)


def facing(imu: Inertial, track: Track) -> Facing | None:
    """Return where forward lies in level axes; None with too little acceleration and cornering."""
    moves = increments(track)
    if moves is None:
        return None
    fits = [
        fit_increments(imu.time, imu.velocity[:, :2], moves.start, moves.end, y)
        for y in (moves.along, moves.across)
    ]
    # GNSS = B · accelerometer; identity when the axes are forward and right.
    B = np.array([fit.coefficients for fit in fits])
    shares = (fits[0].explained, fits[1].explained)
    known = [share > EXPLAINED for share in shares]
    if not any(known):
        return None
    if not all(known):
        return _of_one(fits[known.index(True)], known.index(True), B, shares)
    proper = float(np.hypot(B[0, 0] + B[1, 1], B[0, 1] - B[1, 0])) / 2.0
    mirrored = float(np.hypot(B[0, 0] - B[1, 1], B[0, 1] + B[1, 0])) / 2.0
    turn = float(np.arctan2(B[0, 1] - B[1, 0], B[0, 0] + B[1, 1]))
    sigma = float(np.hypot(fits[0].sigma[1], fits[1].sigma[0])) / (2.0 * proper)
    return Facing(turn, sigma, proper, mirrored > proper, shares, B)


def _of_one(fit: Fit, which: int, B: FloatArray, shares: tuple[float, float]) -> Facing:
    # Without the other motion its axis may have felt nothing: the direction of the response tells.
    along, across = fit.response[which], (1, -1)[which] * fit.response[1 - which]
    gain = float(np.hypot(along, across))
    sigma = float(fit.response_sigma[1 - which]) / gain
    return Facing(float(np.arctan2(across, along)), sigma, gain, False, shares, B)


@dataclass(frozen=True, eq=False)
class Orientation:
    """How axes s are turned against the vehicle's.

    Attributes
    ----------
    down_s : ndarray, shape (3,)
    rate : TurnRatio
        Of the gyro about down against the course; its size is the gyro's unit.
    facing : Facing or None
        Forward in the level plane of `C_sl`.
    C_sl : ndarray, shape (3, 3)
        Level axes, one of them as near as can be to an axis of s.
    problem : str
        Why forward is not told; '' where it is.
    """

    down_s: FloatArray
    rate: TurnRatio
    facing: Facing | None
    C_sl: FloatArray
    problem: str

    @property
    def C_sv(self) -> FloatArray:
        """``x_s = C_sv @ x_v``, shape (3, 3)."""
        assert self.facing is not None
        return np.asarray(self.C_sl @ matrix_from_rpy([0.0, 0.0, self.facing.turn]))

    @property
    def sigma(self) -> float:
        """1σ of the rotation, its worst axis, with what roads and tyres leave open [rad]."""
        assert self.facing is not None
        apart = 0.5 * self.facing.disagreement
        return float(np.linalg.norm([self.facing.sigma, apart, _LEVEL, _SLIP]))

    @property
    def up(self) -> str:
        """Which axis points up, as text."""
        axis = int(np.argmax(np.abs(self.down_s)))
        return f"{'xyz'[axis]} points {'down' if self.down_s[axis] > 0.0 else 'up'}"

    @property
    def share(self) -> str:
        """How much of which motions they explain, as text."""
        assert self.facing is not None
        pairs = zip(("speed", "cornering"), self.facing.explained, strict=True)
        said = [f"{100.0 * e:.0f} % of {name}" for name, e in pairs if e > EXPLAINED]
        return " and ".join(said) + " explained"


def named(C_sv: FloatArray) -> tuple[str, FloatArray]:
    """Return the nearest named axes ('RFU') of s, and C_bv, the mounting left with them."""
    C_bs = all_axes()
    C_bv = C_bs @ C_sv
    best = int(np.argmax(np.trace(C_bv, axis1=1, axis2=2)))
    return axes_name(C_bs[best]), C_bv[best]


def orientation(imu: Inertial, track: Track) -> Orientation:
    """Return how the axes of an IMU are turned against those of a vehicle that goes ahead.

    Parameters
    ----------
    imu : Inertial
        In its own axes, stamps in order; angular rates in any unit.
    track : Track
        Velocities to decimetres per second.
    """
    mean = (imu.velocity[-1] - imu.velocity[0]) / (imu.time[-1] - imu.time[0])
    down = -mean / np.linalg.norm(mean)
    C_sl = _level(down)
    found = facing(imu.turned(C_sl.T), track)
    if found is not None and not found.mirrored:
        down = _driven(imu, track, C_sl, found) - mean
        down /= np.linalg.norm(down)
        C_sl = _level(down)
        found = facing(imu.turned(C_sl.T), track)
    course = track.course(COURSE_SPEED)
    rate = gyro_unit_ratio(imu.time, imu.gyro @ down, track.time, course)
    return Orientation(down, rate, found, C_sl, _problem(rate, found))


def _driven(imu: Inertial, track: Track, C_sl: FloatArray, found: Facing) -> FloatArray:
    """Return the mean of what speed and cornering add to gravity, in axes s [m/s²].

    A drive that turns more to one side leans on it: by degrees, if it is short.
    """
    moves = increments(track)
    assert moves is not None
    inside = (moves.start >= imu.time[0]) & (moves.end <= imu.time[-1])
    if not inside.any():
        return np.zeros(3)
    seconds = float((moves.end - moves.start)[inside].sum())
    # Where cornering is not known the vehicle is slow.
    sums = [float(np.nansum(part[inside])) for part in (moves.along, moves.across)]
    mean_v = np.array([*sums, 0.0]) / seconds
    return np.asarray(C_sl @ matrix_from_rpy([0.0, 0.0, found.turn]) @ mean_v)


def _problem(rate: TurnRatio, found: Facing | None) -> str:
    if found is None:
        return "too little acceleration and cornering to tell forward"
    if found.mirrored:
        return "speed and cornering fit no right-handed set of axes: one column has another sign"
    if rate.conclusive and rate.ratio < 0.0:
        return "the gyro turns against the course, seen from gravity: signs of one of them differ"
    if max(found.explained) < CERTAIN and len(found.motions) < 2:
        share = 100.0 * max(found.explained)
        return f"too little motion to tell forward: {found.how}, {share:.0f} % explained"
    sigma = float(np.hypot(found.sigma, 0.5 * found.disagreement))
    if sigma > _SURE:
        return f"too little motion to tell forward: ± {min(np.degrees(sigma), 180.0):.0f}°"
    if not _GAIN[0] < found.gain < _GAIN[1]:
        return f"the accelerometer's gain against GNSS is {found.gain:.2g}: its unit, or its clock"
    return ""


def _level(down: FloatArray) -> FloatArray:
    """Return level axes C_sl, x beside the axis of s that lies flattest."""
    axis = np.eye(3)[int(np.argmin(np.abs(down)))]
    x = axis - (axis @ down) * down
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(down, x), down])


def mounting_rpy_deg(C_bv: FloatArray) -> list[float]:
    """Return roll, pitch and yaw of an IMU in its vehicle as declarations have them [deg]."""
    return [float(v) for v in np.round(np.degrees(rpy_from_matrix(C_bv.T)), 1) + 0.0]
