"""Position and velocity for a start: each GNSS velocity with the position nearest to it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ....alignment.levelling import InitialAttitude, VelocityTrack
from ....datasets.sequence import Calibration
from ....filters.levers import lever_velocity, rate_over_earth
from ....filters.rotation import FloatArray
from ....filters.strapdown import InertialStream, NavState
from ...vehicles import Vehicle
from ..events import GnssEvent
from .state import Start

#: Positions agree that lie so near to their median, and as far as one gets meanwhile [m], [m/s].
_NEAR, _FASTEST = 1000.0, 100.0
#: Velocities agree that lie so near to the median of those around them, beside 3σ: what any
#: vehicle on wheels gains in the time to their middle [m/s²], within so long [s].
_ACCELERATION, _AROUND = 10.0, 2.2
#: Pairs among which those around a velocity are looked for.
_LATEST = 100
#: A velocity can start the filter if a position lies this close to it [s].
POSITION_NEAR = 2.5


class Fixes:
    """What GNSS has offered so far that can be used.

    Parameters
    ----------
    stream : InertialStream
        May grow.
    calibration : Calibration
    vehicle : Vehicle
        Velocities that it cannot have start nothing.

    Attributes
    ----------
    position : GnssEvent or None
        The latest.
    counts : dict
        Positions and velocities so far.
    """

    def __init__(self, stream: InertialStream, calibration: Calibration, vehicle: Vehicle) -> None:
        self.stream, self.calibration, self.vehicle = stream, calibration, vehicle
        self._all: list[tuple[GnssEvent, GnssEvent]] = []
        self._possible: list[bool] = []
        self._plausible: list[bool] = []
        self.position: GnssEvent | None = None
        self.counts = {"position": 0, "velocity": 0}
        self._unpaired: list[GnssEvent] = []

    def add(self, event: GnssEvent) -> list[tuple[GnssEvent, GnssEvent]]:
        """Take an event; return the pairs it completes."""
        if event.reason or event.kind not in self.counts:
            return []
        self.counts[event.kind] += 1
        if event.kind == "position":
            self.position = event
        elif self.stream.edges[1] <= event.time < self.stream.end:  # a sample has ended by then
            self._unpaired.append(event)
        position = self.position
        if position is None:
            return []
        near = [v for v in self._unpaired if abs(position.time - v.time) <= POSITION_NEAR]
        self._unpaired = [v for v in self._unpaired if v.time > position.time + POSITION_NEAR]
        made = [(velocity, position) for velocity in near]
        self._all += made
        self._look(len(made))
        return made

    @property
    def pairs(self) -> list[tuple[GnssEvent, GnssEvent]]:
        """Pairs that agree with most of the others: one bad fix levels nothing."""
        if len(self._all) < 2:
            return list(self._all)
        pos_e = np.array([p.value_e for _, p in self._all])
        time = np.array([p.time for _, p in self._all])
        reach = _NEAR + _FASTEST * np.ptp(time)
        near: NDArray[np.bool_] = np.linalg.norm(pos_e - np.median(pos_e, axis=0), axis=1) <= reach
        near &= self._plausible
        return [pair for pair, ok in zip(self._all, near, strict=True) if ok]

    def _look(self, new: int) -> None:
        """Judge the velocities of so many new pairs, and anew those that they are around."""
        if not new:
            return
        first = self._all[-new][0].time - _AROUND
        begin = len(self._all) - new
        while begin > 0 and self._all[begin - 1][0].time >= first:
            begin -= 1
        self._possible += [self._can_have(*pair) for pair in self._all[-new:]]
        self._plausible[begin:] = [self._borne_out(k) for k in range(begin, len(self._all))]

    def _can_have(self, velocity: GnssEvent, position: GnssEvent) -> bool:
        """Tell whether a velocity is one that the vehicle can have."""
        doubt = 3.0 * velocity.sigma
        climb = velocity.value_e @ position.value_e / np.linalg.norm(position.value_e)
        return bool(
            level_speed(velocity, position) <= self.vehicle.max_speed + doubt
            and abs(climb) <= self.vehicle.max_height_rate + doubt
        )

    def _borne_out(self, k: int) -> bool:
        """Tell whether the velocity of pair k is possible, and near the median of those around."""
        if not self._possible[k]:
            return False
        velocity, begin = self._all[k][0], max(len(self._all) - _LATEST, 0)
        around = [
            v.value_e
            for (v, _), possible in zip(self._all[begin:], self._possible[begin:], strict=True)
            if possible and abs(v.time - velocity.time) <= _AROUND
        ]
        if len(around) < 3:
            return True
        # Their median; np.median takes ten times as long, and at 10 Hz this is asked often.
        ordered = np.sort(around, axis=0)
        median = 0.5 * (ordered[(len(around) - 1) // 2] + ordered[len(around) // 2])
        off = np.linalg.norm(velocity.value_e - median)
        return bool(off <= _ACCELERATION * _AROUND / 2.0 + 3.0 * velocity.sigma)

    def track(self) -> VelocityTrack:
        """Return all velocities, with their positions, as levelling takes them."""
        return VelocityTrack(
            np.array([v.time for v, _ in self.pairs]),
            np.array([v.value_e for v, _ in self.pairs]),
            np.array([v.sigma for v, _ in self.pairs]),
            np.array([p.value_e for _, p in self.pairs]),
        )

    def at(self, time: FloatArray) -> NDArray[np.bool_]:
        """Return at which of the times there is a pair."""
        paired = np.array([v.time for v, _ in self.pairs])
        return np.any(np.abs(time[:, None] - paired) < 1e-6, axis=1)

    def start(self, attitude: InitialAttitude) -> Start:
        """Return the start with position and velocity from GNSS, moved from antenna to IMU."""
        v, p = min(self.pairs, key=lambda pair: abs(pair[0].time - attitude.time))
        pos_e = p.value_e + v.value_e * (attitude.time - p.time)
        lever_e = attitude.C_eb @ self.calibration.lever_antenna_b
        state = NavState(
            attitude.time, pos_e - lever_e, v.value_e - self.lever_velocity(attitude),
            attitude.C_eb,
        )  # fmt: skip
        return Start(attitude, state, p.cov_e, v.cov_e, fix=p)

    def lever_velocity(self, attitude: InitialAttitude) -> FloatArray:
        """Return C_eb (ω_eb × lever), the antenna's velocity less the IMU's [m/s]."""
        k = min(self.stream.index(attitude.time), len(self.stream) - 1)
        rate_b = rate_over_earth(attitude.C_eb, self.stream.gyro[k] - attitude.gyro_bias)
        return lever_velocity(attitude.C_eb, rate_b, self.calibration.lever_antenna_b)


def level_speed(velocity: GnssEvent, position: GnssEvent) -> float:
    """Return the horizontal speed [m/s]."""
    up = position.value_e / np.linalg.norm(position.value_e)
    return float(np.linalg.norm(velocity.value_e - up * (up @ velocity.value_e)))
