"""One recording as every run over it has it: GNSS, the start, the noise of what GNSS offers.

What a run does with them depends on its method; they do not. Whoever runs several methods over one
recording has them computed once, and what then differs is the method alone. Or else (`own_noise`)
every run is what it is by itself, to the last digit, and shares what is the same for others.
"""

from __future__ import annotations

import dataclasses
import time
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...datasets.sequence import Sequence
from ...filters.errors import AlignmentError
from ...filters.strapdown import InertialStream
from ..config import AlignmentConfig, Config, FilterConfig, GnssConfig, VehicleConfig
from ..notes import Note
from ..solution import Epochs, FixErrors
from .blind import blind_axes, blind_spells
from .fix_noise.fitted import with_fitted_noise, with_noise
from .gnss import GnssTimeline, gnss_timeline
from .legs import Course, found_start
from .model import error_model
from .start.state import Start
from .vehicle import VehicleConstraints
from .velocity_noise.fitted import VelocityErrors, with_fitted_velocities, with_velocities

#: A start, and how long it took to find [s].
Found = tuple[Start, float]
#: What of a configuration a plain run depends on.
Key = tuple[AlignmentConfig, FilterConfig, GnssConfig, VehicleConfig]
#: Noise of velocities and of positions, and what to say of it.
Fitted = tuple[VelocityErrors | None, FixErrors | None, tuple[Note, ...]]

#: What Doppler does below four satellites.
_BELOW_FOUR = ("below_four", "forward_motion", "ddia_min_k", "ddia_min_cn0_dbhz")
#: What of its settings changes nothing of what GNSS offers: the filter goes by it alone.
_OF_THE_FILTER = (
    *_BELOW_FOUR[1:], "clock_walk_mps", "doppler_hold_off_s", "position_noise", "velocity_noise",
    "doppler_known_mps", "position_correlation_s", "delay_sigma_s",
)  # fmt: skip
#: So many configurations of GNSS are kept: what they offer is as large as the recording.
_KEPT = 4


class Prepared:
    """What the runs over one recording have in common, each part computed when first asked for.

    The noise of positions and velocities is fitted with a plain run: without vehicle constraints,
    and with nothing from fewer than four satellites.

    Parameters
    ----------
    sequence : Sequence
    starts : mapping, optional
        Starts that are known already, as of `starts` of another one.
    own_noise : bool
        Fit it with each run's own configuration instead, as `navigate` does by itself: once for all
        that provably have the same, which what Doppler does below four satellites does not change
        where there are four throughout.

    Attributes
    ----------
    starts : dict
        Start, and the time it took to find [s], by what it depends on of a configuration.
    """

    def __init__(
        self,
        sequence: Sequence,
        starts: Mapping[Key, Found] | None = None,
        *,
        own_noise: bool = False,
    ) -> None:
        self.sequence, self.own_noise = sequence, own_noise
        self.starts: dict[Key, Found] = dict(starts or {})
        imu = sequence.inertial
        self._stream = InertialStream(imu.time, imu.gyro_b, imu.accel_b)
        self._positions: OrderedDict[tuple, Any] = OrderedDict()
        self._timelines: OrderedDict[GnssConfig, GnssTimeline] = OrderedDict()
        self._noise: dict[Key, Fitted] = {}
        self._noise_above: dict[Key, Fitted] = {}  # of four satellites and more throughout
        self._failed: dict[Key, str] = {}

    def timeline(self, config: Config) -> GnssTimeline:
        """Return all that GNSS has to offer under a configuration."""
        key = offered_by(config).gnss
        if key not in self._timelines:
            self._timelines[key] = gnss_timeline(self.sequence, config.gnss, self._positions)
        self._timelines.move_to_end(key)
        for known in (self._timelines, self._positions):
            while len(known) > _KEPT:
                known.popitem(last=False)
        return self._timelines[key]

    def start(self, config: Config) -> Found:
        """Return the start under a configuration, and the time it took to find [s].

        Raises
        ------
        AlignmentError
            Why there is none.
        """
        plain = config if self.own_noise else plain_run(config)
        key = _key(offered_by(plain))
        if key in self._failed:
            raise AlignmentError(self._failed[key])
        if key not in self.starts:
            began = time.perf_counter()
            course = course_over(self.sequence, self._stream, self.timeline(plain), plain)
            try:
                start = found_start(course, course.events)
            except AlignmentError as error:
                self._failed[key] = str(error)
                raise
            self.starts[key] = start, time.perf_counter() - began
        return self.starts[key]

    def course(
        self, config: Config, until: float | None = None
    ) -> tuple[Course, GnssTimeline, FixErrors | None, tuple[Note, ...]]:
        """Return all a run is made of: with its start, and with the noise that fits its positions.

        Parameters
        ----------
        config : Config
        until : float, optional
            Time after which there is no GNSS [s]. Noise is then what is known by that time.
        """
        timeline, start = self.timeline(config), self.start(config)
        if until is not None:
            timeline = ended(timeline, until)
        course = course_over(self.sequence, self._stream, timeline, config)
        course = dataclasses.replace(course, start=start)
        if until is not None:
            course, _, said = with_fitted_velocities(course, _silent)
            course, errors, notes = with_fitted_noise(course, timeline.misfit, _silent)
            return course, timeline, errors, (*said, *notes)
        velocities, errors, notes = self.noise(config)
        if velocities is not None:
            course = with_velocities(course, velocities)
        if errors is not None:
            course = with_noise(course, errors)
        return course, timeline, errors, notes

    def noise(self, config: Config) -> Fitted:
        """Return what fits velocities and positions, and what to say of it."""
        plain = config if self.own_noise else plain_run(config)
        key, above = _key(plain), _key(_as_usual(plain, _BELOW_FOUR))
        found = self._noise.get(key) or self._noise_above.get(above)
        if found is not None:
            return found
        timeline = self.timeline(plain)
        course = course_over(self.sequence, self._stream, timeline, plain)
        course = dataclasses.replace(course, start=self.start(plain))
        course, velocities, said = with_fitted_velocities(course, _silent)
        course, errors, notes = with_fitted_noise(course, timeline.misfit, _silent)
        found = velocities, errors, (*said, *notes)
        few = course.below_four or any(event.kind == "doppler" for event in timeline.events)
        if few or plain.gnss.below_four == "off":  # then such epochs are no events
            self._noise[key] = found
        else:
            self._noise_above[above] = found
        return found


def course_over(
    sequence: Sequence, stream: InertialStream, timeline: GnssTimeline, config: Config
) -> Course:
    """Return what a run over a recording is made of, its start still to be found."""
    vehicle = VehicleConstraints(sequence.calibration, config.vehicle, sequence.odometer)
    known = [e for e in timeline.events if e.kind == "velocity" and not e.reason]
    vehicle.measure(
        np.array([e.time for e in known]), np.array([np.linalg.norm(e.value_e) for e in known])
    )
    model = error_model(
        sequence.calibration, config, odometer=vehicle.odometer is not None,
        doppler=any(e.observations is not None for e in timeline.events),
        shared=any(e.shared for e in timeline.events), nhc=vehicle.nhc,
    )  # fmt: skip
    imu = sequence.inertial
    blind = tuple(blind_axes(imu, timeline.events))
    spells = tuple(blind_spells(imu, blind))
    return Course(
        timeline.events, stream, sequence.calibration, vehicle, model, spells, config, blind=blind
    )


def ended(timeline: GnssTimeline, until: float) -> GnssTimeline:
    """Return what GNSS has offered up to a time [s]."""
    epochs = timeline.epochs
    inside = epochs.time <= until
    return dataclasses.replace(
        timeline,
        events=tuple(event for event in timeline.events if event.time <= until),
        epochs=Epochs(epochs.time[inside], epochs.tracked[inside], epochs.usable[inside]),
    )


def plain_run(config: Config) -> Config:
    """Return a configuration without what only the filter makes a difference of.

    No constraints of the vehicle, nothing from fewer than four satellites, no smoother.
    """
    return dataclasses.replace(
        config,
        gnss=dataclasses.replace(config.gnss, below_four="off"),
        filter=dataclasses.replace(config.filter, smooth=False),
        vehicle=without_constraints(config).vehicle,
    )


def without_constraints(config: Config) -> Config:
    """Return a configuration in which nothing is asked of the vehicle."""
    vehicle = dataclasses.replace(config.vehicle, nhc="off", odometer="off", zupt=False, zaru=False)
    return dataclasses.replace(config, vehicle=vehicle)


def offered_by(config: Config) -> Config:
    """Return a configuration under which GNSS offers the same, the rest of it as by default."""
    few = config.gnss.below_four != "off"  # what two or three satellites are used for is no matter
    return _as_usual(config, (*_OF_THE_FILTER, "below_four") if few else _OF_THE_FILTER)


def _as_usual(config: Config, names: tuple[str, ...]) -> Config:
    """Return a configuration with these settings of GNSS as they are by default."""
    usual = GnssConfig()
    gnss = dataclasses.replace(config.gnss, **{name: getattr(usual, name) for name in names})
    return dataclasses.replace(config, gnss=gnss)


def _key(plain: Config) -> Key:
    return plain.alignment, plain.filter, plain.gnss, plain.vehicle


def _silent(fraction: float, what: str) -> None:
    pass
