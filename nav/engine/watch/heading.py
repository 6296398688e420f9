"""Is the heading still what the accelerations say? A filter led astray does not find that out.

A filter that starts with a heading far off may correct it by less than its linearisation promises,
be sure of what is left, and from then on explain everything by its biases. Velocities of GNSS and
the IMU alone, over half a minute, give the heading without it (`alignment.velocity_matching`);
where that is far from the filter's, and for long, the filter is lost.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from ....alignment.levelling import LARGEST_SIGMA_HEADING
from ....alignment.velocity_matching import heading_offset
from ....filters.earth import C_en_of, gravity_e
from ....filters.ekf import ErrorStateFilter
from ....filters.error_model import ATT
from ....filters.rotation import FloatArray, crossed, matrix_from_rotvec
from ..events import GnssEvent
from .sanity import Lost

#: Velocities held against the heading: over how long, and how far apart at least [s].
_WINDOW, _APART = 30.0, 0.9
#: How often the heading is looked at [s].
_EVERY = 2.5
#: So many σ off, of both together, and for so long [s]; no patience where updates are refused.
_SIGMAS, _LASTING = 4.0, 7.0


class _Interval(NamedTuple):
    """What happened up to a velocity: from the one before, in body axes of its end.

    ``turned @ x`` takes body axes of its end to those of its beginning.
    """

    time: float
    vel_e: FloatArray
    sigma: float
    lever_velocity_b: FloatArray
    felt_b: FloatArray
    turned: FloatArray


class HeadingMonitor:
    """Holds the heading of one filter against velocities and the IMU.

    Parameters
    ----------
    kalman : ErrorStateFilter
        Started: its biases are believed as far from the start's as its IMU's may be, for
        beyond they may be the astray filter's way to explain what it sees.
    lever_antenna_b : ndarray, shape (3,)
        [m].
    """

    def __init__(self, kalman: ErrorStateFilter, lever_antenna_b: FloatArray) -> None:
        self.lever_antenna_b = lever_antenna_b
        imu = kalman.model.imu
        spread = [imu.gyro_bias_initial_sigma] * 3 + [imu.accel_bias_initial_sigma] * 3
        self._spread = 3.0 * np.array(spread)
        self._start_bias = kalman.bias[:6].copy()
        self._believed = self._start_bias
        self._intervals: deque[_Interval] = deque()
        self._gravity_e: FloatArray | None = None
        self._looked = -np.inf
        self._since: float | None = None
        self._begin_interval()

    def _begin_interval(self) -> None:
        self._felt_b, self._turned = np.zeros(3), np.eye(3)

    def blind(self) -> None:
        """Forget everything: an axis of the IMU measures nothing."""
        self._intervals.clear()
        self._since = None
        self._begin_interval()

    def propagated(
        self, vel_e: FloatArray, C_eb: FloatArray, dt: float, kalman: ErrorStateFilter
    ) -> None:
        """Take what the IMU did over `dt` [s] that began with this velocity and attitude."""
        if self._gravity_e is None:
            self._gravity_e = gravity_e(kalman.pos_e)
        more = (kalman.bias[:6] - self._believed) * dt
        back = C_eb.T @ kalman.C_eb @ matrix_from_rotvec(more[:3])
        felt_b = kalman.C_eb.T @ (kalman.vel_e - vel_e - self._gravity_e * dt) + more[3:]
        self._felt_b = back.T @ self._felt_b + felt_b
        self._turned = self._turned @ back

    def take(
        self, velocity: GnssEvent, kalman: ErrorStateFilter, agreed: tuple[str, ...] = ()
    ) -> None:
        """Take a velocity of the antenna, whatever becomes of it in the filter.

        But where enough satellites for a velocity of their own, `agreed`, were just taken by the
        filter and say another: then one of the two groups is of reflections, and which, neither
        tells. All satellites of a filter led astray say the same.
        """
        time, vel_e = velocity.time, velocity.value_e
        if not np.isfinite(vel_e).all():
            return
        if self._intervals and time - self._intervals[-1].time < _APART:
            return
        lever_velocity_b = crossed(kalman.omega_b, self.lever_antenna_b)
        if len(agreed) >= 4 and not set(velocity.satellites) <= set(agreed):
            theirs_e = kalman.vel_e + kalman.C_eb @ lever_velocity_b
            if np.linalg.norm(vel_e - theirs_e) > _SIGMAS * velocity.sigma:
                return
        self._gravity_e = gravity_e(kalman.pos_e)
        near = np.minimum(kalman.bias[:6] - self._start_bias, self._spread)
        self._believed = self._start_bias + np.maximum(near, -self._spread)
        self._intervals.append(
            _Interval(time, vel_e, velocity.sigma, lever_velocity_b, self._felt_b, self._turned)
        )
        self._begin_interval()
        while self._intervals[0].time < time - _WINDOW:
            self._intervals.popleft()

    def look(self, kalman: ErrorStateFilter, refused: bool) -> None:
        """Raise `Lost` if the filter's heading is far from what the velocities say.

        Parameters
        ----------
        kalman : ErrorStateFilter
            As it is after the last velocity.
        refused : bool
            Whether measurements have been refused in a row.
        """
        if not self._intervals or self._intervals[-1].time - self._looked < _EVERY:
            return
        self._looked = self._intervals[-1].time
        found, limit = self._off(kalman)
        if not np.isfinite(limit):
            return  # nothing is said: neither for nor against
        if abs(found) <= limit:
            self._since = None
            return
        self._since = self._looked if self._since is None else self._since
        if refused or self._looked - self._since >= _LASTING:
            raise Lost(
                f"velocities and accelerations say that the heading is {np.degrees(found):+.0f}° "
                f"off, the filter that it is known to {_sigma_deg(kalman):.1f}°"
            )

    def _off(self, kalman: ErrorStateFilter) -> tuple[float, float]:
        """Return by how much the heading is off, and what that would have to exceed [rad]."""
        parts = list(self._intervals)
        C_ne = C_en_of(kalman.pos_e).T
        C_nb = np.empty((len(parts), 3, 3))
        C_nb[-1] = C_ne @ kalman.C_eb
        for k in range(len(parts) - 1, 0, -1):
            C_nb[k - 1] = C_nb[k] @ parts[k].turned.T
        felt_n = np.einsum("kij,kj->ki", C_nb, np.array([p.felt_b for p in parts]))
        felt_n[0] = 0.0
        lever_n = np.einsum("kij,kj->ki", C_nb, np.array([p.lever_velocity_b for p in parts]))
        found = heading_offset(
            np.array([p.time for p in parts]),
            (np.array([p.vel_e for p in parts]) @ C_ne.T)[:, :2],
            np.array([p.sigma for p in parts]),
            (np.cumsum(felt_n, axis=0) + lever_n)[:, :2],
            C_nb,
        )
        if found is None or not found.tells:
            return 0.0, np.inf
        limit = _SIGMAS * float(np.hypot(found.sigma, np.radians(_sigma_deg(kalman))))
        return found.offset, max(limit, LARGEST_SIGMA_HEADING)


def _sigma_deg(kalman: ErrorStateFilter) -> float:
    """Return 1σ of the heading [deg]."""
    down_b = kalman.C_eb.T @ C_en_of(kalman.pos_e)[:, 2]
    return float(np.degrees(np.sqrt(down_b @ kalman.P[ATT, ATT] @ down_b)))
