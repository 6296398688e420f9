"""A seeded drive through a grid of streets: the path in space, the timing along it.

The path is a list of straights and 90° turns over horizontal arc length σ; heading is a
smoothstep of σ inside a turn. The timing is a list of phases in which the horizontal speed
changes by a smoothstep of time. Height is a smooth field over the plane. The vehicle points
where it moves, so the non-holonomic constraint holds at the middle of the rear axle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...filters.rotation import FloatArray

#: Node spacing of the sampled drive [s], a power of two so that node times are exact.
NODE_INTERVAL = 2.0**-5
#: Nodes in the second before the drive begins, which IMU intervals and filters may need.
_NODES_BEFORE = 32
#: Streets per direction (some 5 km across) and the distance between them [m].
_STREETS = 33
_SPACING = (80.0, 250.0)
#: Stops are this far before the corner, the drive begins this far behind one [m].
_STOP_LINE = 15.0
_PARKED = 25.0

_Phase = tuple[float, float, float]


def smoothstep(x: ArrayLike) -> FloatArray:
    """Return 35x⁴ − 84x⁵ + 70x⁶ − 20x⁷ clipped to [0, 1]: C³, S(0) = 0, S(1) = 1."""
    u = np.clip(np.asarray(x, dtype=float), 0.0, 1.0)
    return u**4 * (35.0 + u * (-84.0 + u * (70.0 - 20.0 * u)))


def smoothstep_integral(x: ArrayLike) -> FloatArray:
    """Return ∫₀ˣ S of `smoothstep` for x in [0, 1]; its value at 1 is 1/2."""
    u = np.asarray(x, dtype=float)
    return u**5 * (7.0 + u * (-14.0 + u * (10.0 - 2.5 * u)))


def _turn_reach() -> float:
    """Return ∫₀¹ cos(π/2·S): what a turn of unit length covers along either street."""
    x, w = np.polynomial.legendre.leggauss(40)
    return float(0.5 * w @ np.cos(0.5 * np.pi * smoothstep(0.5 * (x + 1.0))))


TURN_REACH = _turn_reach()
#: Largest slope of `smoothstep`, at x = 1/2.
_STEEPEST = 35.0 / 16.0


@dataclass(frozen=True)
class RouteConfig:
    """How the car is driven.

    Parameters
    ----------
    duration : float
        The drive lasts at least this long [s].
    static_start : float
        Standstill at the beginning [s].
    moving_start : bool
        Begin at cruising speed instead.
    stop_probability : float
        Of a red light at an intersection.
    stop_duration : (float, float)
        Range of waiting times at lights [s].
    cruise : (float, float)
        Range of cruising speeds [m/s].
    turn_probability : float
        Of leaving an intersection to the left or right.
    max_grade : float
        Bound of the slope of the road, rise over run.
    roll_per_accel : float
        Body roll to the outside of a turn per lateral acceleration [rad/(m/s²)].
    """

    duration: float = 600.0
    static_start: float = 30.0
    moving_start: bool = False
    stop_probability: float = 0.35
    stop_duration: tuple[float, float] = (5.0, 30.0)
    cruise: tuple[float, float] = (8.0, 15.0)
    turn_probability: float = 0.5
    max_grade: float = 0.06
    roll_per_accel: float = 0.004


@dataclass(frozen=True, eq=False)
class HeightField:
    """Sum of plane waves whose slopes add up to no more than the bound.

    Parameters
    ----------
    wave_vector : ndarray, shape (k, 2)
        North and east components [rad/m].
    amplitude, phase : ndarray, shape (k,)
        [m], [rad].
    """

    wave_vector: FloatArray
    amplitude: FloatArray
    phase: FloatArray

    @classmethod
    def draw(cls, rng: np.random.Generator, max_grade: float, waves: int = 6) -> HeightField:
        """Return a field with wavelengths of 400–1600 m."""
        number = 2.0 * np.pi / rng.uniform(400.0, 1600.0, waves)
        azimuth = rng.uniform(0.0, 2.0 * np.pi, waves)
        share = rng.dirichlet(np.full(waves, 2.0))
        wave_vector = number[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
        return cls(wave_vector, max_grade * share / number, rng.uniform(0, 2 * np.pi, waves))

    def __call__(self, north_east: FloatArray) -> FloatArray:
        """Return the height [m] at positions of shape (n, 2)."""
        return np.sin(north_east @ self.wave_vector.T + self.phase) @ self.amplitude

    def gradient(self, north_east: FloatArray) -> FloatArray:
        """Return the slope towards north and east, shape (n, 2)."""
        waves = np.cos(north_east @ self.wave_vector.T + self.phase) * self.amplitude
        return waves @ self.wave_vector


@dataclass(frozen=True, eq=False)
class Block:
    """One stretch of street between two intersections, as driven.

    Parameters
    ----------
    key : tuple of int
        Names the stretch whatever the direction of travel: indices (north, east) of the
        intersection at its south or west end, and 0 if it runs north, 1 if it runs east.
    start, end : float
        Horizontal arc length at which the car enters and leaves it [m].
    heading : float
        Direction of travel [rad].
    length : float
        From intersection to intersection [m].
    corner_t : ndarray, shape (2,)
        North and east of the intersection in `key` [m].
    """

    key: tuple[int, int, int]
    start: float
    end: float
    heading: float
    length: float
    corner_t: FloatArray


@dataclass(frozen=True, eq=False)
class Drive:
    """A sampled drive, ready to be splined.

    Parameters
    ----------
    time : ndarray, shape (n,)
        From the beginning of the drive [s]; a second longer at both ends.
    pos_t : ndarray, shape (n, 3)
        Middle of the rear axle, north, east, down of the start [m].
    rpy : ndarray, shape (n, 3)
        Roll, pitch, heading (unwrapped) [rad].
    arc_length : ndarray, shape (n,)
        Horizontal [m].
    blocks : tuple of Block
        In the order they are driven.
    """

    time: FloatArray
    pos_t: FloatArray
    rpy: FloatArray
    arc_length: FloatArray
    blocks: tuple[Block, ...]

    def block_at(self, time: ArrayLike) -> np.ndarray:
        """Return the index of the block the car is in at each time."""
        arc = np.interp(np.asarray(time, dtype=float), self.time, self.arc_length)
        ends = np.array([b.end for b in self.blocks])
        return np.minimum(np.searchsorted(ends, arc, side="right"), len(ends) - 1)


@dataclass(frozen=True)
class _Turn:
    """A 90° turn over ``[start, start + length]`` of arc; `sign` +1 to the right."""

    start: float
    length: float
    sign: int
    speed: float


@dataclass(frozen=True)
class _Waypoint:
    """Where the car must have a given speed, and how long it stays there if it stands."""

    arc: float
    speed: float
    dwell: float = 0.0


def drive(config: RouteConfig, rng: np.random.Generator) -> Drive:
    """Return a drive of at least ``config.duration`` through a new grid of streets."""
    field = HeightField.draw(rng, config.max_grade)
    first_heading = 0.5 * np.pi * int(rng.integers(4))
    # Mean progress is far below the fastest cruise: a path for that speed is always enough.
    reach = config.cruise[1] * (config.duration + 60.0)
    blocks, turns, stops = _plan(config, rng, first_heading, reach)
    phases = _timing(config, rng, turns, stops)
    count = int(np.ceil((config.duration + 1.0) / NODE_INTERVAL)) + 1
    time: FloatArray = NODE_INTERVAL * np.arange(-_NODES_BEFORE, count, dtype=float)
    arc, speed = _along(phases, time)
    heading, curvature = _heading(turns, first_heading, arc)
    plane = _plane(turns, first_heading, arc)
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    slope = np.sum(field.gradient(plane) * direction, axis=-1)
    height = field(plane) - field(np.zeros((1, 2)))
    roll = -config.roll_per_accel * speed**2 * curvature
    return Drive(
        time=time,
        pos_t=np.column_stack([plane, -height]),
        rpy=np.stack([roll, np.arctan(slope), heading], axis=-1),
        arc_length=arc,
        blocks=tuple(b for b in blocks if b.start <= arc[-1]),
    )


def _plan(
    config: RouteConfig, rng: np.random.Generator, first_heading: float, reach: float
) -> tuple[list[Block], list[_Turn], list[_Waypoint]]:
    """Walk the grid at random: blocks with arc lengths, turns at corners, stops before lights."""
    # gap[axis, k]: from street k to k + 1, northwards (0) or eastwards (1).
    gap = rng.uniform(*_SPACING, (2, _STREETS - 1))
    lines = np.concatenate([np.zeros((2, 1)), np.cumsum(gap, axis=1)], axis=1)
    node = [_STREETS // 2, _STREETS // 2]
    quarter = round(first_heading / (0.5 * np.pi))
    covered = 0.0 if config.moving_start else _PARKED  # of this block, before arc 0 or by a turn
    way = np.array([np.cos(first_heading), np.sin(first_heading)])
    origin = lines[[0, 1], node] + covered * way
    blocks: list[Block] = []
    turns: list[_Turn] = []
    stops: list[_Waypoint] = []
    arc = entered = 0.0
    while arc < reach:
        axis, step = quarter % 2, _step(quarter)
        after = list(node)
        after[axis] += step
        low = node if step > 0 else after
        length = float(gap[axis, low[axis]])
        choice = _choose(config, rng, after, quarter)
        bend, speed = _turn_shape(rng)
        red = rng.random() < config.stop_probability
        if config.moving_start and not blocks:
            choice, red = 0, False
        shortcut = TURN_REACH * bend if choice else 0.0
        corner = arc + length - covered - shortcut
        if red:
            dwell = float(rng.uniform(*config.stop_duration))
            stops.append(_Waypoint(corner - _STOP_LINE, 0.0, dwell))
        if choice:
            turns.append(_Turn(corner, bend, choice, speed))
        arc = corner + (bend if choice else 0.0)
        left = 0.5 * (corner + arc)
        corner_t = lines[[0, 1], low] - origin
        key = (low[0], low[1], axis)
        blocks.append(Block(key, entered, left, 0.5 * np.pi * quarter, length, corner_t))
        entered, covered = left, shortcut
        node, quarter = after, quarter + choice
    return blocks, turns, stops


def _step(quarter: int) -> int:
    """Return +1 for driving north or east, −1 for south or west."""
    return 1 if quarter % 4 in (0, 1) else -1


def _choose(config: RouteConfig, rng: np.random.Generator, node: list[int], quarter: int) -> int:
    """Return −1, 0 or +1 (left, straight on, right) such that the next block exists."""

    def inside(turn: int) -> bool:
        return 0 <= node[(quarter + turn) % 2] + _step(quarter + turn) < _STREETS

    wanted = 0 if rng.random() >= config.turn_probability else int(rng.choice([-1, 1]))
    return next(turn for turn in (wanted, -wanted or 1, -1, 0) if inside(turn))


def _turn_shape(rng: np.random.Generator) -> tuple[float, float]:
    """Return length [m] and speed [m/s] of a turn with 2–3.3 m/s² at its sharpest point."""
    speed = float(rng.uniform(4.0, 6.5))
    length = float(np.clip(0.5 * np.pi * _STEEPEST * speed**2 / rng.uniform(2.0, 3.0), 20, 42))
    return length, speed


def _timing(
    config: RouteConfig, rng: np.random.Generator, turns: list[_Turn], stops: list[_Waypoint]
) -> list[_Phase]:
    """Return phases (duration, speed at the beginning, speed at the end) of the whole drive."""
    begins = [_Waypoint(t.start, t.speed) for t in turns]
    ends = [_Waypoint(t.start + t.length, t.speed) for t in turns]
    bends = {t.start for t in turns}
    speed = float(rng.uniform(*config.cruise)) if config.moving_start else 0.0
    # One second of it lies before time 0.
    phases: list[_Phase] = [(1.0 + (2.0 if speed else config.static_start), speed, speed)]
    previous = _Waypoint(2.0 * speed, speed)
    for waypoint in sorted([*stops, *begins, *ends], key=lambda w: w.arc):
        distance = waypoint.arc - previous.arc
        if previous.arc in bends:
            phases.append((distance / previous.speed, previous.speed, previous.speed))
        else:
            phases += _between(config, rng, distance, previous.speed, waypoint.speed)
        if waypoint.dwell:
            phases.append((waypoint.dwell, 0.0, 0.0))
        previous = waypoint
        if sum(p[0] for p in phases) > config.duration + 3.0:
            return phases
    # No more corners or lights: drive on.
    top = config.cruise[1]
    return [*phases, (10.0, previous.speed, top), (config.duration + 3.0, top, top)]


def _between(
    config: RouteConfig, rng: np.random.Generator, distance: float, v0: float, v1: float
) -> list[_Phase]:
    """Return phases that cover `distance` from speed v0 to v1, through cruise if there is room.

    A smoothstep change of mean acceleration a from u to w covers |w² − u²|/(2a).
    """
    a0, a1 = rng.uniform(0.7, 1.2), rng.uniform(0.8, 1.4)
    cruise = float(rng.uniform(*config.cruise))
    peak = np.sqrt((2.0 * distance + v0**2 / a0 + v1**2 / a1) / (1.0 / a0 + 1.0 / a1))
    if peak <= max(v0, v1):
        return [(2.0 * distance / (v0 + v1), v0, v1)]
    top = max(min(cruise, peak), v0, v1)
    phases = [((top - v0) / a0, v0, top)]
    room = distance - (top**2 - v0**2) / (2 * a0) - (top**2 - v1**2) / (2 * a1)
    phases.append((max(room, 0.0) / top, top, top))
    phases.append(((top - v1) / a1, top, v1))
    return [p for p in phases if p[0] > 0.0]


def _along(phases: list[_Phase], time: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return horizontal arc length and speed at times counted from one second into the phases."""
    duration, v0, v1 = np.array(phases).T
    begins = np.cumsum(duration) - duration
    mean = 0.5 * (v0 + v1)
    arcs = np.cumsum(mean * duration) - mean * duration - v0[0]  # zero at time 0
    x = time + 1.0
    k = np.searchsorted(begins, x, side="right") - 1
    u = np.clip((x - begins[k]) / duration[k], 0.0, 1.0)
    gain = v1[k] - v0[k]
    arc = arcs[k] + duration[k] * (v0[k] * u + gain * smoothstep_integral(u))
    return arc, v0[k] + gain * smoothstep(u)


def _heading(turns: list[_Turn], first: float, arc: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return heading (unwrapped) [rad] and its derivative by arc length [rad/m]."""
    # A turn of no angle in front stands for the road before the first corner.
    start, length, sign = np.array(
        [(-np.inf, 1.0, 0.0), *((t.start, t.length, t.sign) for t in turns)]
    ).T
    quarter = 0.5 * np.pi * sign
    before = first + np.cumsum(quarter) - quarter
    k = np.searchsorted(start, arc, side="right") - 1
    u = np.clip((arc - start[k]) / length[k], 0.0, 1.0)
    slope = 140.0 * (u * (1.0 - u)) ** 3
    return before[k] + quarter[k] * smoothstep(u), quarter[k] * slope / length[k]


def _plane(turns: list[_Turn], first: float, arc: FloatArray) -> FloatArray:
    """Return north and east by Gauss–Legendre integration of the heading over each step of arc."""
    x, w = np.polynomial.legendre.leggauss(6)
    step = np.diff(arc)
    heading, _ = _heading(turns, first, arc[:-1, None] + 0.5 * (x + 1.0) * step[:, None])
    delta = 0.5 * step[:, None] * np.stack([np.cos(heading) @ w, np.sin(heading) @ w], axis=-1)
    plane = np.vstack([np.zeros((1, 2)), np.cumsum(delta, axis=0)])
    return plane - plane[_NODES_BEFORE]
