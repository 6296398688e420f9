"""Waiting for an attitude: a window that grows, then slides, until its verdict passes.

Once a second the last seconds are aligned from IMU and Doppler. What is missing is said in one
line, and the first window that passes every verdict starts the filter, at its end. A standstill on
the way gives the gyro bias, which is what limits the heading otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from ...datasets.observations import GnssObservations
from ...filters.earth import EARTH_RATE
from ...filters.errors import AlignmentError, ConfigError
from ...filters.rotation import FloatArray
from ...filters.standstill import is_quiet
from ...filters.strapdown import InertialStream
from ...velocity.range_rate import doppler_rows
from ..result import Ask
from .align import InertialAlignment, align_epochs
from .rows import DopplerEpoch, joined
from .track import ImuParts
from .unknowns import InertialOptions

#: Spread of z over satellites, in σ, up to which an epoch looks like a standstill.
_STILL = 3.0
#: And from which it is motion: of ten satellites chance has more once in a thousand epochs.
_MOVES = 6.0
#: A first look at a window is right to a factor of two: beyond so many times the limit for the
#: heading nothing can come of it.
_HOPELESS = 2.0
#: What is proved of the optimum alone.
_ABOUT_THE_OPTIMUM = (Ask.OPTIMAL, Ask.UNIQUE, Ask.UNAMBIGUOUS)


@dataclass(frozen=True, eq=False)
class MotionOptions:
    """When to try, and what is good enough.

    Parameters
    ----------
    inertial : InertialOptions
    shortest, longest : float
        Window [s].
    every : float
        Time between attempts [s].
    sigma_heading : float
        1σ that the heading must have, beyond the verdicts [rad].
    shortest_rest : float
        Standstill that gives a gyro bias [s].
    shortest_motion : float
        So much of a window must be motion, or all of it [s]. What is wrong with Doppler stays the
        same for up to 4 s on recordings; twice that, and a start that was led astray for 5 s.
    """

    inertial: InertialOptions = field(default_factory=InertialOptions)
    shortest: float = 5.0
    longest: float = 60.0
    every: float = 1.0
    sigma_heading: float = np.radians(1.5)
    shortest_rest: float = 3.0
    shortest_motion: float = 10.0

    def __post_init__(self) -> None:
        if not 0.0 < self.shortest <= self.longest < np.inf:
            raise ConfigError(
                f"alignment in motion: expected 0 < shortest ≤ longest, found {self.shortest:g} "
                f"and {self.longest:g} s"
            )
        for name in ("every", "sigma_heading", "shortest_rest", "shortest_motion"):
            if not getattr(self, name) > 0.0:
                raise ConfigError(
                    f"alignment in motion: {name}: expected > 0, found {getattr(self, name)!r}"
                )


@dataclass(frozen=True, eq=False)
class Attempt:
    """One window that was tried.

    Attributes
    ----------
    start, time : float
        Its begin and end, GPS time [s].
    passed : bool
    message : str
        What it is waiting for, or what it found; one line.
    alignment : InertialAlignment or None
        None where there was too little to solve for anything, or to be worth it.
    """

    start: float
    time: float
    passed: bool
    message: str
    alignment: InertialAlignment | None


class MotionAligner:
    """Takes Doppler epochs as they come and tries to align on the last of them.

    Everything it decides at an epoch follows from what lies before it, so that recorded and live
    data give the same. An attempt costs the same however long the drive: the window is as long
    as `MotionOptions.longest` at most, and from 50 s of waiting on attempts become rarer, by 2 %
    of the time waited.

    Parameters
    ----------
    stream : InertialStream
        May grow; it must reach a few samples past each epoch that is added.
    lever_b : array_like, shape (3,)
        IMU to antenna [m].
    options : MotionOptions, optional
    """

    def __init__(
        self,
        stream: InertialStream,
        lever_b: ArrayLike = (0.0, 0.0, 0.0),
        options: MotionOptions | None = None,
    ) -> None:
        self.stream, self.lever_b = stream, np.asarray(lever_b, dtype=float)
        self.options = options or MotionOptions()
        self._epochs: list[DopplerEpoch] = []
        self._still: list[bool] = []
        self._moving: list[bool] = []
        self._rest: tuple[FloatArray, float] | None = None
        self._near: FloatArray | None = None
        self._began, self._tried = np.nan, -np.inf
        self._parts = ImuParts(stream)

    def add(self, epoch: DopplerEpoch, attempt: bool = True) -> Attempt | None:
        """Take an epoch later than those before; return the attempt that was due, if one was.

        Parameters
        ----------
        epoch : DopplerEpoch
        attempt : bool
            False: only take it.
        """
        options, inertial = self.options, self.options.inertial
        if self._epochs and epoch.time - self._epochs[-1].time < inertial.interval - 1e-6:
            return None
        if not self._epochs:
            self._began = epoch.time
        self._epochs.append(epoch)
        self._still.append(_is_still(epoch))
        self._moving.append(len(epoch.rows) > 1 and _moves(epoch))
        while epoch.time - self._epochs[0].time > options.longest + 1e-6:
            del self._epochs[0], self._still[0], self._moving[0]
        self._rest = self._at_rest() or self._rest
        rarely = min(0.02 * (epoch.time - self._began), 0.25 * options.longest)
        due = self._tried + max(options.every, rarely)
        long_enough = epoch.time - self._epochs[0].time >= options.shortest - 1e-6
        if not (attempt and long_enough and epoch.time >= due - 1e-6):
            return None
        self._tried = epoch.time
        moved, enough = self._moved(), min(options.shortest_motion, options.longest)
        if moved < enough - 1e-6:
            told = f"in motion for {moved:.0f} s, needs {enough:g} s of it"
            told = told if moved else "at rest, needs motion"
            message = f"not aligned: {told}"
            return Attempt(self._epochs[0].time, epoch.time, False, message, None)
        return self._attempt()

    def _moved(self) -> float:
        """Return how much of the window ended in motion [s].

        At rest satellites agree whatever their signals' paths; setting off straight ahead, those
        reflected at one facade agree on another heading, and for seconds nothing contradicts.
        """
        time = np.array([epoch.time for epoch in self._epochs])
        return float(np.sum(np.diff(time)[self._moving[1:]]))

    def _attempt(self) -> Attempt:
        start, time, options = self._epochs[0].time, self._epochs[-1].time, self.options.inertial
        if self._rest is not None:
            mean, sigma = self._rest
            options = replace(options, gyro_bias=mean, gyro_bias_sigma=sigma)
        doppler, near = joined(self._epochs), self._near
        try:
            found = align_epochs(
                self._parts, doppler, self.lever_b, options, gyro_bias=near,
                look=self._refuse_hopeless if near is None else None,
            )  # fmt: skip
        except AlignmentError as error:
            return Attempt(start, time, False, str(error), None)
        # Where to linearise next: an estimate that passed, else none.
        self._near = found.gyro_bias if found.passed else None
        return _judged(found, self.options)

    def _refuse_hopeless(self, sigma: float) -> None:
        """Raise if nothing can come of a window whose heading at first sight has this 1σ [rad]."""
        if sigma > _HOPELESS * self.options.sigma_heading:
            raise AlignmentError(_too_wide(sigma, self.options))

    def _at_rest(self) -> tuple[FloatArray, float] | None:
        """Return the gyro bias of the standstill that lasts, with its σ; None if there is none.

        What the gyros show then is the bias and the Earth's rate, whose direction is not known
        yet.
        """
        moved = np.flatnonzero(~np.array(self._still))
        first = int(moved[-1]) + 1 if moved.size else 0
        if first >= len(self._epochs):
            return None
        start, end = self._epochs[first].time, self._epochs[-1].time
        if end - start < self.options.shortest_rest - 1e-6:
            return None
        imu = self.options.inertial.imu
        edges = self.stream.edges
        samples = slice(*np.searchsorted(edges, [start, end]))
        gyro = self.stream.gyro[samples]
        if len(gyro) <= 10:
            return None
        interval = (end - start) / len(gyro)
        if not is_quiet(gyro, None, imu, interval, 3.0):
            return None
        noise = imu.gyro_noise_density / np.sqrt(end - start)
        sigma = np.sqrt(noise**2 + imu.gyro_bias_sigma**2 + EARTH_RATE**2)
        return gyro.mean(axis=0), float(sigma)


def attempts(
    stream: InertialStream,
    observations: GnssObservations,
    pos_e: ArrayLike,
    lever_b: ArrayLike = (0.0, 0.0, 0.0),
    options: MotionOptions | None = None,
    *,
    time: ArrayLike | None = None,
) -> Iterator[Attempt]:
    """Yield every attempt on recorded observations, whether it passes or not.

    Parameters
    ----------
    stream : InertialStream
    observations : GnssObservations
        Screened, with satellite states.
    pos_e : array_like, shape (3,) or (n, 3)
        Antenna, approximately [m].
    lever_b : array_like, shape (3,)
        IMU to antenna [m].
    options : MotionOptions, optional
    time : array_like, shape (n,), optional
        GPS time of each row where the receiver's clock is known to be off [s].

    Raises
    ------
    AlignmentError
        If there is no Doppler within the IMU data.
    """
    options = options or MotionOptions()
    when = observations.time if time is None else np.asarray(time, dtype=float)
    position = np.broadcast_to(np.asarray(pos_e, dtype=float), (len(observations), 3))
    rows = doppler_rows(observations, position, options.inertial.noise)
    at = when[rows.row]
    epochs, first = np.unique(at, return_index=True)
    ends = np.append(first[1:], at.size)
    inside = (epochs >= stream.start) & (epochs <= stream.end)
    if np.sum(inside) < 2:
        raise AlignmentError(
            "no Doppler with satellite states within the IMU data — do the times overlap, and "
            "are there navigation files?"
        )
    aligner = MotionAligner(stream, lever_b, options)
    for k in np.flatnonzero(inside):
        here = rows.take(slice(first[k], ends[k]))
        at = position[here.row[0]]
        known = options.inertial.position_sigma
        attempt = aligner.add(DopplerEpoch(float(epochs[k]), at, here, known))
        if attempt is not None:
            yield attempt


def wait_for_alignment(
    stream: InertialStream,
    observations: GnssObservations,
    pos_e: ArrayLike,
    lever_b: ArrayLike = (0.0, 0.0, 0.0),
    options: MotionOptions | None = None,
    *,
    time: ArrayLike | None = None,
    report: Callable[[float, str], None] | None = None,
) -> InertialAlignment:
    """Return the first alignment that passes every verdict: attitude, velocity and biases.

    Parameters
    ----------
    stream, observations, pos_e, lever_b, options, time
        As for `attempts`.
    report : callable, optional
        Called with GPS time and what is being waited for, once an attempt.

    Raises
    ------
    AlignmentError
        If none passes: the last reason, and what would help.
    """
    count, attempt = 0, None
    for attempt in attempts(stream, observations, pos_e, lever_b, options, time=time):
        count += 1
        if report is not None:
            report(attempt.time, attempt.message)
        if attempt.passed and attempt.alignment is not None:
            return attempt.alignment
    if attempt is None:
        shortest = (options or MotionOptions()).shortest
        raise AlignmentError(f"no {shortest:g} s of Doppler within the IMU data to align with")
    raise AlignmentError(
        f"no attitude in motion after {count} attempts; at {attempt.time:.0f} s: "
        f"{attempt.message} — a longer drive with turns, a standstill first, more satellites, or "
        "alignment.method 'level+course' or 'given' would help"
    )


def _judged(found: InertialAlignment, options: MotionOptions) -> Attempt:
    passed = found.passed and found.sigma_heading <= options.sigma_heading
    if passed:
        message = found.initial_attitude().message
    elif found.passed:
        message = _too_wide(found.sigma_heading, options)
    else:
        message = _awaited(found)
    return Attempt(found.start, found.time, passed, message, found)


def _too_wide(sigma: float, options: MotionOptions) -> str:
    known = f"heading ±{np.degrees(sigma):.2g}° 1σ" if sigma < np.radians(100.0) else "no heading"
    limit = np.degrees(options.sigma_heading)
    return f"not aligned: {known} (limit {limit:.2g}°), needs a turn, a change of speed or a rest"


def _awaited(found: InertialAlignment) -> str:
    """Say what is missing in the words of whoever drives.

    Without a bound on the attitude nothing that is proved of its optimum matters yet.
    """
    result = found.result
    bounded = result.verdict(Ask.BOUNDED).passed
    told = [v.message for v in result.failed if bounded or v.name not in _ABOUT_THE_OPTIMUM]
    return "not aligned: " + "; ".join(told)


def _is_still(epoch: DopplerEpoch) -> bool:
    """Tell if three or more satellites see no velocity.

    At rest z is the clock's drift for all satellites, whatever their directions.
    """
    if len(epoch.rows) < 3:
        return False
    off = np.abs(epoch.rows.z - np.median(epoch.rows.z)) / epoch.rows.sigma
    return bool(np.median(off) < 1.0 and off.max() < _STILL)


def _moves(epoch: DopplerEpoch) -> bool:
    """Tell if satellites see more of a velocity than chance makes of a standstill."""
    z, sigma = epoch.rows.z, epoch.rows.sigma
    off = (z - np.average(z, weights=sigma**-2.0)) / sigma
    return bool(np.ptp(off) > _MOVES)
