"""Starts certified in motion: from IMU and Doppler, with a bound on the attitude that is proved.

A certified attitude is worth a wait, for it needs no mounting and no course. The wait costs little
of the solution: what a window proves holds at its beginning, too, as far as the gyros can carry it
back, and the filter begins there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ....filters.earth import OMEGA_IE_E, C_en_of, gravity_e
from ....filters.rotation import FloatArray
from ....filters.sensors import ImuSpec
from ....filters.strapdown import NavState
from ...config import AlignmentConfig
from ..events import GnssEvent
from .fixes import POSITION_NEAR, Fixes
from .state import Start

if TYPE_CHECKING:
    from ....alignment.in_motion.align import InertialAlignment
    from ....alignment.in_motion.rows import DopplerEpoch
    from ....alignment.in_motion.waiting import MotionAligner

#: Share of a window's information that a start at its beginning takes: 1σ is what 3σ was.
_WEIGHT = 1.0 / 9.0
#: How fast the velocity may have changed since the last position, 1σ [m/s²].
_ACCELERATION = 3.0
#: Velocity that can carry a position from longer ago, 1σ [m/s]: in a minute 60 m.
_CARRIES = 1.0


class CertifiedStart:
    """The first window of Doppler that passes every verdict.

    Parameters
    ----------
    fixes : Fixes
    config : AlignmentConfig
    imu : ImuSpec
    say : callable
        Told what is missing.

    Attributes
    ----------
    attempts : list of (float, str)
        GPS time of each attempt [s], and what it was waiting for or found.
    first_epoch : float or None
        GPS time of the first Doppler within the IMU data [s].
    unplaced : bool
        Whether there are no positions to wait for.
    """

    def __init__(
        self, fixes: Fixes, config: AlignmentConfig, imu: ImuSpec, say: Callable[[str], None]
    ) -> None:
        self.fixes, self.config, self.imu, self.say = fixes, config, imu, say
        self.attempts: list[tuple[float, str]] = []
        self.first_epoch: float | None = None
        self.unplaced = False
        self._aligner: MotionAligner | None = None

    def offer(self, event: GnssEvent) -> Start | None:
        """Take the Doppler of an event, if it has any; return the start if a window passes."""
        epoch, stream = event.epoch, self.fixes.stream
        if epoch is None or not stream.start <= epoch.time <= stream.end:
            return None
        if self._aligner is None:
            self._aligner, self.first_epoch = self._new_aligner(), epoch.time
        self.unplaced |= epoch.given is not None
        made = self._aligner.add(epoch)
        if made is None:
            return None
        position = self.fixes.position or _given(epoch, made.alignment)
        age = self.config.position_age_s
        far = position is None or (epoch.given is None and abs(position.time - epoch.time) > age)
        message = made.message
        if made.passed and far:
            message += f"; but no GNSS position within {age:g} s to start from"
        elif made.passed and made.alignment is not None and position is not None:
            # Two or three satellites certify an attitude and leave the velocity along a line open.
            sigma = float(np.sqrt(np.linalg.eigvalsh(made.alignment.cov[3:6, 3:6])[-1]))
            far = made.time - position.time > POSITION_NEAR and sigma > _CARRIES
            if far:
                message += f"; but a velocity of ±{sigma:.3g} m/s carries no old position"
        self.attempts.append((made.time, message))
        self.say(message)
        if not made.passed or far:
            return None
        assert made.alignment is not None and position is not None
        return self._from_window(made.alignment, position)

    def why_not(self) -> str:
        """Say why there is no certified start so far."""
        if self.first_epoch is None:
            return (
                "alignment.method 'certified' needs raw Doppler with satellite states: "
                "observations and navigation files"
            )
        if not self.attempts:
            return "not certified: less than 5 s of Doppler within the IMU data"
        time, message = self.attempts[-1]
        after, count = time - self.first_epoch, len(self.attempts)
        return f"not certified in {count} attempts, the last after {after:.0f} s: {message}"

    def _new_aligner(self) -> MotionAligner:
        from ....alignment.in_motion.unknowns import InertialOptions
        from ....alignment.in_motion.waiting import MotionAligner, MotionOptions
        from ....alignment.problem import ClockModel

        clock = ClockModel("random-walk", self.config.sigma_clock_walk_mps)
        options = MotionOptions(
            InertialOptions(imu=self.imu, clock=clock),
            longest=self.config.max_window_s,
            sigma_heading=float(np.radians(self.config.max_sigma_heading_deg)),
        )
        return MotionAligner(self.fixes.stream, self.fixes.calibration.lever_antenna_b, options)

    def _from_window(self, found: InertialAlignment, position: GnssEvent) -> Start:
        """Return the start at the first epoch of the window where its heading is good enough.

        The window is then filtered, and its Doppler used twice; `_WEIGHT` sees to it that this
        does not make the filter too sure. Without a velocity and a position of GNSS at such an
        epoch the start is at the end.
        """
        at = found.track.time
        down_e = C_en_of(found.pos_e)[:, 2]
        limit = np.radians(self.config.max_sigma_heading_deg)
        for k in map(int, np.flatnonzero(self.fixes.at(at))):
            C_eb, cov = found.carried_to(k)
            if down_e @ cov[:3, :3] @ down_e <= limit**2:
                break
        else:
            return self._from_window_end(found, position)
        C_eb, cov = found.carried_to(k, _WEIGHT)
        ended = found.initial_attitude()
        message = f"{ended.message}; started {found.time - at[k]:.0f} s before its end, at 3σ"
        attitude = replace(
            ended, time=float(at[k]), C_eb=C_eb, cov_e=cov[:3, :3], message=message,
            sigma_heading=float(np.sqrt(down_e @ cov[:3, :3] @ down_e)),
        )  # fmt: skip
        start = self.fixes.start(attitude)
        joint = np.zeros((12, 12))
        inner = np.r_[0:3, 6:12]
        joint[np.ix_(inner, inner)] = cov
        joint[3:6, 3:6] = start.vel_cov_e
        return self._with_window(start, found, joint)

    def _from_window_end(self, found: InertialAlignment, position: GnssEvent) -> Start:
        """Return the start at the end of a window: all but the position is from there."""
        attitude = found.initial_attitude()
        elapsed = found.time - position.time
        vel_antenna_e = found.vel_e + self.fixes.lever_velocity(attitude)
        moved_e, spread = vel_antenna_e * elapsed, 0.5 * _ACCELERATION * elapsed**2
        if elapsed > POSITION_NEAR:
            moved_e, spread = _moved(found, position.time)
        pos_e = position.value_e + moved_e
        lever_e = attitude.C_eb @ self.fixes.calibration.lever_antenna_b
        state = NavState(found.time, pos_e - lever_e, found.vel_e, attitude.C_eb)
        vel_cov_e = found.cov[3:6, 3:6]
        moved = vel_cov_e * elapsed**2 + np.eye(3) * spread**2
        start = Start(attitude, state, position.cov_e + moved, vel_cov_e, fix=position)
        return self._with_window(start, found, found.cov)

    def _with_window(self, start: Start, found: InertialAlignment, joint_cov: FloatArray) -> Start:
        """Add what the window knows; its covariance has the attitude in e axes."""
        T = np.eye(12)
        T[:3, :3] = start.state.C_eb.T
        return replace(
            start, accel_bias=found.accel_bias, certified=found, joint_cov=T @ joint_cov @ T.T,
            attempts=tuple(self.attempts),
        )  # fmt: skip


def _moved(found: InertialAlignment, since: float) -> tuple[FloatArray, float]:
    """Return how far the vehicle went from a time to the window's end [m], and 1σ per axis of it.

    Within the window as the IMU has it, at the velocity of its end less what was gained on the way;
    before it as far as the velocity at its beginning takes it, which may have been another.
    """
    time, end = found.track.time, found.time
    back = (time - end)[:, None]
    vel_e = found.vel_e + found.track.dv_w @ found.C_eb.T
    vel_e += back * (gravity_e(found.pos_e) - 2.0 * np.cross(OMEGA_IE_E, found.vel_e))
    before = max(float(time[0]) - since, 0.0)
    grid = np.r_[max(since, float(time[0])), time[time > since]]
    inside = np.column_stack([np.interp(grid, time, v) for v in vel_e.T])
    way = np.trapezoid(inside, grid, axis=0) + vel_e[0] * before
    # Between epochs the way is that of the mean velocity, but for what changes within a second.
    curved = _ACCELERATION / 12.0 * float(np.sum(np.diff(grid) ** 2))
    return way, 0.5 * _ACCELERATION * before**2 + curved


def _given(epoch: DopplerEpoch, found: InertialAlignment | None) -> GnssEvent | None:
    """Return the one position there is where it is none of the receiver's; None where it is.

    A window that reaches back to when it holds, and knows its velocity, carries it from there.
    For any other it is where lines of sight were computed for: as far off as a vehicle gets.
    """
    if epoch.given is None:
        return None
    since, sigma = epoch.given
    carried = (
        found is not None
        and float(found.track.time[0]) - since <= POSITION_NEAR
        and float(np.sqrt(np.linalg.eigvalsh(found.cov[3:6, 3:6])[-1])) <= _CARRIES
    )
    if carried:
        return GnssEvent(since, "position", epoch.pos_e, sigma**2 * np.eye(3))
    return GnssEvent(epoch.time, "position", epoch.pos_e, epoch.position_sigma**2 * np.eye(3))
