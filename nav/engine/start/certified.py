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

from ....filters.earth import C_en_of
from ....filters.rotation import FloatArray
from ....filters.sensors import ImuSpec
from ....filters.strapdown import NavState
from ...config import AlignmentConfig
from ..events import GnssEvent
from .fixes import POSITION_NEAR, Fixes
from .state import Start

if TYPE_CHECKING:
    from ....alignment.in_motion.align import InertialAlignment
    from ....alignment.in_motion.waiting import MotionAligner

#: Share of a window's information that a start at its beginning takes: 1σ is what 3σ was.
_WEIGHT = 1.0 / 9.0
#: How fast the velocity may have changed since the last position, 1σ [m/s²].
_ACCELERATION = 3.0


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
    """

    def __init__(
        self, fixes: Fixes, config: AlignmentConfig, imu: ImuSpec, say: Callable[[str], None]
    ) -> None:
        self.fixes, self.config, self.imu, self.say = fixes, config, imu, say
        self.attempts: list[tuple[float, str]] = []
        self.first_epoch: float | None = None
        self._aligner: MotionAligner | None = None

    def offer(self, event: GnssEvent) -> Start | None:
        """Take the Doppler of an event, if it has any; return the start if a window passes."""
        epoch, stream = event.epoch, self.fixes.stream
        if epoch is None or not stream.start <= epoch.time <= stream.end:
            return None
        if self._aligner is None:
            self._aligner, self.first_epoch = self._new_aligner(), epoch.time
        made = self._aligner.add(epoch)
        if made is None:
            return None
        position = self.fixes.position
        far = position is None or abs(position.time - epoch.time) > POSITION_NEAR
        message = made.message
        if made.passed and far:
            message += f"; but no GNSS position within {POSITION_NEAR} s to start from"
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
        pos_e = position.value_e + vel_antenna_e * elapsed
        lever_e = attitude.C_eb @ self.fixes.calibration.lever_antenna_b
        state = NavState(found.time, pos_e - lever_e, found.vel_e, attitude.C_eb)
        vel_cov_e = found.cov[3:6, 3:6]
        moved = vel_cov_e * elapsed**2 + np.eye(3) * (0.5 * _ACCELERATION * elapsed**2) ** 2
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
