"""Starts that need no Doppler of satellites: an attitude that is given, or levelling and course."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ....alignment.direction import Fit, course_fit, log_odds
from ....alignment.levelling import (
    LARGEST_SIGMA_HEADING,
    LEVEL_WINDOW,
    InitialAttitude,
    given_attitude,
    level_and_course,
)
from ....filters.earth import C_en_of
from ....filters.errors import AlignmentError
from ....filters.sensors import ImuSpec
from ...config import AlignmentConfig
from ..events import GnssEvent
from .fixes import Fixes, level_speed
from .state import Start

#: What levelling in motion looks at past its instant [s].
_LEVEL_AFTER = 0.5 * LEVEL_WINDOW + 2.0
#: After a failure levelling is tried again so much later [s].
_AGAIN = 1.0
#: ln of the odds, before anything is measured, that a vehicle moves nose first: 100 to 1; and of
#: those that are enough: once in a thousand starts such odds are wrong.
_FORWARDS, _SURE = float(np.log(100.0)), float(np.log(1000.0))
_OPEN = "nose or tail first is not decided"
_ALONE = "other velocities do not bear out the course"
#: Satellites of a velocity that are too many to be reflections at one facade, which hides half of
#: the sky, and to agree.
_MANY = 8
#: Longer than this after its instant an attitude is not disputed any more [s].
_GIVEN_UP = 25.0


def given_start(fixes: Fixes, config: AlignmentConfig, agreeing: int = 2) -> Start | None:
    """Return the start with the attitude of the configuration, once positions agree."""
    if len(fixes.pairs) < agreeing:
        return None
    velocity, position = fixes.pairs[0]
    level, heading = np.radians([config.sigma_level_deg, config.sigma_heading_deg])
    rpy = np.radians(np.array([config.roll_deg, config.pitch_deg, config.heading_deg], dtype=float))
    return fixes.start(given_attitude(velocity.time, position.value_e, rpy, level, heading))


class LevelledStart:
    """Level, and heading from course, once that is known and it is clear which way round.

    Parameters
    ----------
    fixes : Fixes
    config : AlignmentConfig
    imu : ImuSpec
    say : callable
        Told what is missing.

    Attributes
    ----------
    unheard : Start or None
        The first that nothing spoke against and nothing bore out in the time it could have been:
        for want of a better one.
    """

    def __init__(
        self, fixes: Fixes, config: AlignmentConfig, imu: ImuSpec, say: Callable[[str], None]
    ) -> None:
        self.fixes, self.config, self.imu, self.say = fixes, config, imu, say
        self.unheard: Start | None = None
        self._due: float | None = None
        self._after = -np.inf

    def take(self, pairs: list[tuple[GnssEvent, GnssEvent]]) -> None:
        """Look at the speeds of new pairs."""
        slowest = self.config.min_speed_mps
        for velocity, position in pairs:
            if self._due is None and level_speed(velocity, position) >= slowest:
                self._due = velocity.time + 1e-3  # with the epoch after it
            if self._due is None:
                self.say(f"no heading: slower than {slowest:.1f} m/s so far")

    def offer(self, now: float) -> Start | None:
        """Return the start if it is due by `now` [s] and can be had.

        After a standstill that is at once, else as soon as there is what levelling in motion
        looks at past its instant; in either case when it is clear whether nose or tail goes first.
        """
        if self._due is None or now < self._due:
            return None
        try:
            attitude, odds = self._attitude()
        except AlignmentError as error:
            self.say(str(error))
            self._due = now + _AGAIN
            return None
        ready = attitude.time + _LEVEL_AFTER
        if attitude.sigma_gyro_bias is None and now < ready:
            self.say(f"levelling: complete at {ready:.1f} s")
            self._due = ready
            return None
        fit = course_fit(self.fixes.stream, self.fixes.track(), attitude)
        if fit.against:
            self.say(fit.against)
            self._due, self._after = now + _AGAIN, attitude.time + 1e-3
            return None
        doubt = self._doubt(attitude, odds, fit)
        if not doubt:
            return self._start(attitude, fit)
        self.say(f"{doubt}: a turn or a change of speed would tell")
        self._due = now + _AGAIN
        if now > attitude.time + _GIVEN_UP:
            self._after = now - _AGAIN  # what gyros carry no further is tried anew
            if doubt is _ALONE and self.unheard is None:
                self.unheard = self._start(attitude, fit, doubt)
        return None

    def at_last(self) -> Start:
        """Return the start from what there is: no more will come.

        Raises
        ------
        AlignmentError
            Why there is none.
        """
        if self.unheard is not None:
            return self.unheard
        self._after = -np.inf
        attitude, odds = self._attitude()
        while (fit := course_fit(self.fixes.stream, self.fixes.track(), attitude)).against:
            self._after = attitude.time + 1e-3
            attitude, odds = self._attitude()
        doubt = self._doubt(attitude, odds, fit)
        return self._start(
            attitude, fit, f"{doubt}: the likelier is taken" if odds < _SURE else doubt
        )

    def _doubt(self, attitude: InitialAttitude, odds: float, fit: Fit) -> str:
        """Return what is still open about an attitude, if anything is.

        Few satellites may all be reflections, and agree: others have to bear such a velocity out.
        """
        if odds < _SURE:
            return _OPEN
        return "" if fit.borne_out or len(self._behind(attitude)) >= _MANY else _ALONE

    def _behind(self, attitude: InitialAttitude) -> tuple[str, ...]:
        """Return the satellites of the velocity that the course is of; none if they are unknown."""
        return next((v.satellites for v, _ in self.fixes.pairs if v.time == attitude.time), ())

    def _start(self, attitude: InitialAttitude, fit: Fit, doubt: str = "") -> Start:
        """Return the start; what is open about it is said."""
        few = 0 < len(self._behind(attitude)) < _MANY
        attitude = self._as_sure_as(attitude, LARGEST_SIGMA_HEADING if few else fit.sigma)
        if doubt:
            attitude = replace(attitude, message=f"{attitude.message}; {doubt}")
        return replace(self.fixes.start(attitude), doubt=doubt)

    def _as_sure_as(self, attitude: InitialAttitude, sigma: float) -> InitialAttitude:
        """Return an attitude whose heading is no better known than what bears it out.

        A velocity may be wrong by far more than it says, and its course with it; of few satellites
        that is seldom, and then by tens of degrees. Beyond 10° (1σ) it is the filter that bears no
        more.
        """
        sigma = min(sigma, LARGEST_SIGMA_HEADING)
        if sigma <= attitude.sigma_heading:
            return attitude
        down_e = C_en_of(self.fixes.pairs[0][1].value_e)[:, 2]
        more = (sigma**2 - attitude.sigma_heading**2) * np.outer(down_e, down_e)
        return replace(attitude, cov_e=attitude.cov_e + more, sigma_heading=sigma)

    def _attitude(self) -> tuple[InitialAttitude, float]:
        """Return the likelier attitude, and ln of the odds for it against half a turn more."""
        forwards, backwards = self.attitude(), self.attitude(backwards=True)
        odds = _FORWARDS + log_odds(self.fixes.stream, self.fixes.track(), forwards, backwards)
        return (forwards, odds) if odds >= 0.0 else (backwards, -odds)

    def attitude(self, backwards: bool = False) -> InitialAttitude:
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
            backwards=backwards, after=self._after,
        )  # fmt: skip
