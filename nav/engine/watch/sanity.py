"""Is the solution still one of a vehicle? When it is not, it is lost, and says so.

A filter that is doubted may be enlarged once, and again; what follows is bounded by what the
vehicle can do. One that moves as no vehicle moves, or that has to be doubted again and again though
independent measurements agree with each other, has an attitude or a state that no enlarging mends.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from ....filters.earth import HIGHEST_RADIUS, LOWEST_RADIUS
from ....filters.ekf import ErrorStateFilter
from ....filters.error_model import VEL
from ....filters.errors import DataError
from ....filters.rotation import FloatArray

#: Doubted so often within so long [s], the filter is lost: on sound drives it is once or twice.
_TIMES, _WITHIN = 5, 30.0
#: How long it may move as no vehicle does [s]: one wild epoch is the gate's business.
_LASTING = 1.0
#: Over what an acceleration is a mean [s].
_SECONDS = 3.0


class Lost(DataError):
    """The solution has left what its vehicle can do; it needs a new start."""


@dataclass(frozen=True)
class Limits:
    """What a vehicle can do.

    Parameters
    ----------
    speed, height_rate : float
        [m/s].
    acceleration : float
        Over seconds [m/s²].
    """

    speed: float = 90.0
    height_rate: float = 20.0
    acceleration: float = 15.0


class Sanity:
    """Watches one filter.

    Parameters
    ----------
    limits : Limits
    """

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self._since: float | None = None
        self._doubts: list[float] = []
        self._velocities: deque[tuple[float, FloatArray, float]] = deque()

    def look(self, kalman: ErrorStateFilter) -> None:
        """Raise `Lost` if the filter has moved for a while as its vehicle cannot."""
        what = self._impossible(kalman)
        if not what:
            self._since = None
            return
        if self._since is None:
            self._since = kalman.time
        lasted = kalman.time - self._since
        if lasted >= _LASTING:
            raise Lost(f"{what} for {lasted:.1f} s, as no vehicle of its kind (vehicle.kind)")

    def doubted(self, time: float, kind: str) -> None:
        """Take note that the filter was doubted for a measurement; raise `Lost` if too often."""
        self._doubts = [t for t in self._doubts if time - t <= _WITHIN] + [time]
        if len(self._doubts) >= _TIMES:
            raise Lost(
                f"{kind} and the filter contradict each other: doubted {len(self._doubts)} times "
                f"in {time - self._doubts[0]:.0f} s"
            )

    def _impossible(self, kalman: ErrorStateFilter) -> str:
        radius = float(np.sqrt(kalman.pos_e @ kalman.pos_e))
        if not LOWEST_RADIUS < radius < HIGHEST_RADIUS:
            return f"{(radius - 6_371_000.0) / 1000.0:.0f} km above the Earth's mean radius"
        sigma = float(np.sqrt(max(kalman.P.diagonal()[VEL].tolist())))
        speed = float(np.sqrt(kalman.vel_e @ kalman.vel_e))
        if speed > self.limits.speed + 3.0 * sigma:
            return f"at {speed:.0f} m/s (limit {self.limits.speed:.0f})"
        climb = abs(float(kalman.vel_e @ kalman.pos_e)) / radius
        if climb > self.limits.height_rate + 3.0 * sigma:
            return f"climbing or sinking at {climb:.0f} m/s (limit {self.limits.height_rate:.0f})"
        return self._wild_acceleration(kalman, sigma)

    def _wild_acceleration(self, kalman: ErrorStateFilter, sigma: float) -> str:
        """Say so if velocities some seconds apart differ by more than forces on a vehicle can do.

        A velocity that is corrected by what it was not known to is no acceleration.
        """
        past = self._velocities
        while len(past) > 1 and kalman.time - past[1][0] >= _SECONDS:
            past.popleft()
        past.append((kalman.time, kalman.vel_e.copy(), sigma))
        begin, vel_e, before = past[0]
        if not _SECONDS <= (elapsed := kalman.time - begin) <= 2.0 * _SECONDS:
            return ""
        change = float(np.linalg.norm(kalman.vel_e - vel_e))
        if change <= self.limits.acceleration * elapsed + 3.0 * (sigma + before):
            return ""
        return (
            f"its velocity changed by {change:.0f} m/s in {elapsed:.1f} s "
            f"(limit {self.limits.acceleration:.0f} m/s²)"
        )
