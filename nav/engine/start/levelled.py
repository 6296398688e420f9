"""Starts that need no Doppler of satellites: an attitude that is given, or levelling and course."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ....alignment.levelling import (
    LEVEL_WINDOW,
    REST_SPEED,
    InitialAttitude,
    given_attitude,
    level_and_course,
)
from ....filters.errors import AlignmentError
from ....filters.sensors import ImuSpec
from ...config import AlignmentConfig
from ..events import GnssEvent
from .fixes import Fixes, level_speed, sigma_of
from .state import Start

#: What levelling in motion looks at past its instant [s].
_LEVEL_AFTER = 0.5 * LEVEL_WINDOW + 2.0
#: After a failure levelling is tried again so much later [s].
_AGAIN = 1.0


def given_start(fixes: Fixes, config: AlignmentConfig) -> Start | None:
    """Return the start with the attitude of the configuration, once there is a velocity."""
    if not fixes.pairs:
        return None
    velocity, position = fixes.pairs[0]
    level, heading = np.radians([config.sigma_level_deg, config.sigma_heading_deg])
    rpy = np.radians(np.array([config.roll_deg, config.pitch_deg, config.heading_deg], dtype=float))
    return fixes.start(given_attitude(velocity.time, position.value_e, rpy, level, heading))


class LevelledStart:
    """Level, and heading from course, once it is fast enough.

    Parameters
    ----------
    fixes : Fixes
    config : AlignmentConfig
    imu : ImuSpec
    say : callable
        Told what is missing.
    """

    def __init__(
        self, fixes: Fixes, config: AlignmentConfig, imu: ImuSpec, say: Callable[[str], None]
    ) -> None:
        self.fixes, self.config, self.imu, self.say = fixes, config, imu, say
        self.tried = False
        self._due: float | None = None

    def take(self, pairs: list[tuple[GnssEvent, GnssEvent]]) -> None:
        """Look at the speeds of new pairs."""
        slowest = self.config.min_speed_mps
        for velocity, position in pairs:
            if self._due is None and level_speed(velocity, position) >= slowest:
                self._due = velocity.time + 1e-3  # with the epoch after it
            if self._due is None:
                self.say(f"no heading: slower than {slowest:.1f} m/s so far")

    @property
    def began_at_rest(self) -> bool:
        """Whether GNSS saw a standstill first, and levelling has not been tried yet."""
        if self.tried or not self.fixes.pairs:
            return False
        velocity, _ = self.fixes.pairs[0]
        limit = max(REST_SPEED, 3.0 * sigma_of(velocity))
        return bool(np.linalg.norm(velocity.value_e) <= limit)

    def offer(self, now: float) -> Start | None:
        """Return the start if it is due by `now` [s] and can be had.

        After a standstill that is at once, else as soon as there is what levelling in motion
        looks at past its instant.
        """
        if self._due is None or now < self._due:
            return None
        self.tried = True
        try:
            attitude = self.attitude()
        except AlignmentError as error:
            self.say(str(error))
            self._due = now + _AGAIN
            return None
        ready = attitude.time + _LEVEL_AFTER
        if attitude.sigma_gyro_bias is None and now < ready:
            self.say(f"levelling: complete at {ready:.1f} s")
            self._due = ready
            return None
        return self.fixes.start(attitude)

    def attitude(self) -> InitialAttitude:
        """Return the attitude from all there is so far.

        Raises
        ------
        AlignmentError
            Why there is none.
        """
        config, calibration = self.config, self.fixes.calibration
        level, heading = np.radians([config.sigma_level_deg, config.sigma_heading_deg])
        return level_and_course(
            self.fixes.stream, self.fixes.track(), calibration.C_bv, self.imu,
            min_speed=config.min_speed_mps, sigma_level=level, sigma_heading=heading,
        )  # fmt: skip
