"""Which start to take: the rule of ``alignment.method``.

Events are taken one by one in the order of time, and what is decided at one follows from what
lies before it: a recorded drive and the same drive live start at the same instant with the same
numbers. The rule of 'auto':

    roll, pitch and heading given   →  these, at the first velocity with a position
    raw Doppler                     →  certified in motion, if a window passes within twice
                                       `max_window_s` of the first Doppler, whether or not it
                                       began with a standstill
    no raw Doppler, or no window    →  levelled, at rest if there was a standstill, heading from
       passed by then                  course, at the instant at which there was enough for it;
                                       the message says why

After two windows without a pass there is no telling when one will.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ....datasets.sequence import Calibration
from ....filters.error_model import ErrorModel
from ....filters.errors import AlignmentError
from ....filters.strapdown import InertialStream
from ...config import AlignmentConfig
from ...vehicles import VEHICLES
from ..events import GnssEvent
from .certified import CertifiedStart
from .fixes import POSITION_NEAR, Fixes
from .levelled import LevelledStart, given_start
from .state import Start

#: Windows without a pass after which 'auto' waits no longer for a certified attitude.
_WINDOWS = 2.0


class StartFinder:
    """Finds the initial attitude, and position and velocity at its time, from events as they come.

    Parameters
    ----------
    stream : InertialStream
        May grow; it must reach a few samples past an event when that is offered.
    calibration : Calibration
    config : AlignmentConfig
    model : ErrorModel
    kind : str
        Of vehicle (`nav.vehicles`).

    Attributes
    ----------
    waiting : str
        What is missing, in one line.
    """

    def __init__(
        self,
        stream: InertialStream,
        calibration: Calibration,
        config: AlignmentConfig,
        model: ErrorModel,
        kind: str = "car",
    ) -> None:
        self.config, self.waiting = config, "no data yet"
        known = None not in (config.roll_deg, config.pitch_deg, config.heading_deg)
        self.method = "given" if known and config.method == "auto" else config.method
        self._fixes = Fixes(stream, calibration, VEHICLES[kind])
        self._levelled = LevelledStart(self._fixes, config, model.imu, self._say)
        self._certified = CertifiedStart(self._fixes, config, model.imu, self._say)
        self._fallback: Start | None = None
        self._last = -np.inf

    @property
    def attempts(self) -> list[tuple[float, str]]:
        """GPS time of each certified attempt [s], and what it was waiting for or found."""
        return self._certified.attempts

    def offer(self, event: GnssEvent) -> Start | None:
        """Take an event; return the start if there now is one.

        An event earlier than the one before comes too late to matter here and is passed over.
        """
        if event.time < self._last - 1e-9:
            return None
        self._last = event.time
        self._levelled.take(self._fixes.add(event))
        if self.method == "given":
            return self._known(given_start(self._fixes, self.config))
        levelled = None
        if self.method != "certified" and self._fallback is None:
            levelled = self._levelled.offer(event.time)
        if self.method != "level+course":
            certified = self._certified.offer(event)
            if certified is not None:
                return self._known(certified)
        self._fallback = self._fallback or self._known(levelled)
        waited = self._certified.first_epoch is None or event.time >= self._deadline
        fallback = self._fallback or self._known(self._levelled.unheard)
        if fallback is None or self.method == "certified" or not waited:
            return None
        return self._without_certificate(fallback)

    def close(self) -> Start:
        """Return the start from what there is: no more will come.

        Raises
        ------
        AlignmentError
            Why there is no attitude.
        """
        missing = [kind for kind, count in self._fixes.counts.items() if not count]
        if self.method == "certified":
            raise AlignmentError(self._certified.why_not())
        if missing and self._certified.unplaced:
            raise AlignmentError(self._certified.why_not())
        if missing:
            raise AlignmentError(
                f"no usable GNSS {missing[0]}, so there is nothing to start from — `certnav check` "
                "says what the recording holds"
            )
        if not self._fixes.pairs:
            raise AlignmentError(
                f"no GNSS velocity with a position within {POSITION_NEAR} s inside the IMU data"
            )
        if self.method == "given":
            given = self._known(given_start(self._fixes, self.config, agreeing=1))
            assert given is not None
            return given
        if self._fallback is None:
            try:
                self._fallback = replace(self._levelled.at_last(), known=self._last)
            except AlignmentError as error:
                if not self.attempts:
                    raise
                raise AlignmentError(f"{error}; {self._certified.why_not()}") from None
        return self._without_certificate(self._fallback)

    def _say(self, waiting: str) -> None:
        self.waiting = waiting

    def _known(self, start: Start | None) -> Start | None:
        """Return a start that has just been found with the time at which it was."""
        return None if start is None else replace(start, known=self._last)

    @property
    def _deadline(self) -> float:
        """When 'auto' has waited long enough for a window [s]."""
        first = self._certified.first_epoch
        return np.inf if first is None else first + _WINDOWS * self.config.max_window_s

    def _without_certificate(self, start: Start) -> Start:
        """Return a levelled start with the reason why it is not a certified one."""
        attitude = start.attitude
        if self.attempts:
            message = f"{attitude.message}; {self._certified.why_not()}"
            attitude = replace(attitude, message=message)
        return replace(start, attitude=attitude, attempts=tuple(self.attempts))


def again(config: AlignmentConfig) -> AlignmentConfig:
    """Return what a start after a lost solution goes by: an attitude given was of the first."""
    method = "auto" if config.method == "given" else config.method
    return replace(config, method=method, roll_deg=None, pitch_deg=None, heading_deg=None)


def find_start(
    events: tuple[GnssEvent, ...],
    stream: InertialStream,
    calibration: Calibration,
    config: AlignmentConfig,
    model: ErrorModel,
    kind: str = "car",
) -> Start:
    """Find the start of a recording.

    Raises
    ------
    AlignmentError
        Why there is no attitude.
    """
    finder = StartFinder(stream, calibration, config, model, kind)
    for event in events:
        start = finder.offer(event)
        if start is not None:
            return start
    return finder.close()
