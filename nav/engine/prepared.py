"""One recording as every run over it has it: GNSS, the start, the noise of what GNSS offers.

What a run does with them depends on its method; they do not. Whoever runs several methods over one
recording has them computed once, and what then differs is the method alone.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping

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


class Prepared:
    """What the runs over one recording have in common, each part computed when first asked for.

    The noise of positions and velocities is fitted with a plain run: without vehicle constraints,
    and with nothing from fewer than four satellites.

    Parameters
    ----------
    sequence : Sequence
    starts : mapping, optional
        Starts that are known already, as of `starts` of another one.

    Attributes
    ----------
    starts : dict
        Start, and the time it took to find [s], by what it depends on of a configuration.
    """

    def __init__(self, sequence: Sequence, starts: Mapping[Key, Found] | None = None) -> None:
        self.sequence = sequence
        self.starts: dict[Key, Found] = dict(starts or {})
        imu = sequence.inertial
        self._stream = InertialStream(imu.time, imu.gyro_b, imu.accel_b)
        self._timelines: dict[GnssConfig, GnssTimeline] = {}
        self._noise: dict[Key, Fitted] = {}
        self._failed: dict[Key, str] = {}

    def timeline(self, config: Config) -> GnssTimeline:
        """Return all that GNSS has to offer under a configuration."""
        if config.gnss not in self._timelines:
            self._timelines[config.gnss] = gnss_timeline(self.sequence, config.gnss)
        return self._timelines[config.gnss]

    def start(self, config: Config) -> Found:
        """Return the start under a configuration, and the time it took to find [s].

        Raises
        ------
        AlignmentError
            Why there is none.
        """
        plain = plain_run(config)
        key = _key(plain)
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
        velocities, errors, notes = self._errors(config)
        if velocities is not None:
            course = with_velocities(course, velocities)
        if errors is not None:
            course = with_noise(course, errors)
        return course, timeline, errors, notes

    def _errors(self, config: Config) -> Fitted:
        plain = plain_run(config)
        key = _key(plain)
        if key not in self._noise:
            timeline = self.timeline(plain)
            course = course_over(self.sequence, self._stream, timeline, plain)
            course = dataclasses.replace(course, start=self.start(plain))
            course, velocities, said = with_fitted_velocities(course, _silent)
            _, errors, notes = with_fitted_noise(course, timeline.misfit, _silent)
            self._noise[key] = velocities, errors, (*said, *notes)
        return self._noise[key]


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


def _key(plain: Config) -> Key:
    return plain.alignment, plain.filter, plain.gnss, plain.vehicle


def _silent(fraction: float, what: str) -> None:
    pass
