"""Waiting for an attitude: a window that grows, then slides, until its verdict passes.

At every epoch the last seconds are aligned from IMU and Doppler. What is missing is said in one
line an epoch, and the first window that passes every verdict starts the filter, at its end. A
standstill on the way gives the gyro bias, which is what limits the heading otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from alignment.inertial import InertialAlignment, align_epochs
from alignment.inertial_rows import InertialDoppler, inertial_doppler, inertial_track
from alignment.inertial_unknowns import InertialOptions
from alignment.initial import InitialAttitude
from datasets.sequence import GnssObservations
from filters.earth import EARTH_RATE, OMEGA_IE_SKEW
from filters.errors import AlignmentError, ConfigError
from filters.rotation import FloatArray
from filters.sensors import ImuSpec
from filters.strapdown import InertialStream

#: Spread of z over satellites, in σ, up to which an epoch looks like a standstill.
_STILL = 3.0
#: Gyro within a second, per axis, beyond its own noise, while the engine idles [rad/s].
_IDLE_GYRO = np.radians(0.3)


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
    """

    inertial: InertialOptions = field(default_factory=InertialOptions)
    shortest: float = 5.0
    longest: float = 60.0
    every: float = 1.0
    sigma_heading: float = np.radians(1.5)
    shortest_rest: float = 3.0

    def __post_init__(self) -> None:
        if not 0.0 < self.shortest <= self.longest < np.inf:
            raise ConfigError(
                f"alignment in motion: expected 0 < shortest ≤ longest, found {self.shortest:g} "
                f"and {self.longest:g} s"
            )
        for name in ("every", "sigma_heading", "shortest_rest"):
            if not getattr(self, name) > 0.0:
                raise ConfigError(
                    f"alignment in motion: {name}: expected > 0, found {getattr(self, name)!r}"
                )


@dataclass(frozen=True, eq=False)
class Attempt:
    """One window that was tried.

    Attributes
    ----------
    time : float
        Its end, GPS time [s].
    passed : bool
    message : str
        What it is waiting for, or what it found; one line.
    alignment : InertialAlignment or None
        None where there was too little to solve for anything.
    """

    time: float
    passed: bool
    message: str
    alignment: InertialAlignment | None


def attempts(
    stream: InertialStream,
    observations: GnssObservations,
    pos_e: ArrayLike,
    lever_b: ArrayLike = (0.0, 0.0, 0.0),
    options: MotionOptions | None = None,
    *,
    time: ArrayLike | None = None,
) -> Iterator[Attempt]:
    """Yield one attempt an epoch, whether it passes or not.

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
    inertial = options.inertial
    doppler, which = _within(stream, observations, np.asarray(pos_e, dtype=float), inertial, time)
    when = doppler.time
    track = inertial_track(stream, when)
    still = _still(doppler)
    bias: FloatArray | None = None
    tried = -np.inf
    for last in range(1, when.size):
        first = int(np.searchsorted(when, when[last] - options.longest - 1e-6))
        elapsed = float(when[last] - when[first])
        if elapsed < options.shortest - 1e-6 or when[last] - tried < options.every - 1e-6:
            continue
        tried = float(when[last])
        known = _at_rest(stream, when, still, last, inertial.imu, options.shortest_rest)
        current = inertial if known is None else _with_bias(inertial, *known)
        try:
            found = align_epochs(
                stream, doppler, first, last, lever_b, current,
                gyro_bias=bias, track=track if bias is None else None,
            )  # fmt: skip
        except AlignmentError as error:
            yield Attempt(tried, False, str(error), None)
            continue
        # Where to linearise next: an estimate that passed, else none.
        bias = found.gyro_bias if found.passed else None
        # Indices into the observations as given.
        yield _judged(replace(found, source=which[found.source]), tried, options)


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


def align_in_motion(
    stream: InertialStream,
    observations: GnssObservations,
    pos_e: ArrayLike,
    lever_b: ArrayLike = (0.0, 0.0, 0.0),
    options: MotionOptions | None = None,
    *,
    time: ArrayLike | None = None,
    report: Callable[[float, str], None] | None = None,
) -> InitialAttitude:
    """Return the first attitude that passes every verdict; see `wait_for_alignment`."""
    return wait_for_alignment(
        stream, observations, pos_e, lever_b, options, time=time, report=report
    ).initial_attitude()


def _within(
    stream: InertialStream, observations: GnssObservations, pos_e: FloatArray,
    options: InertialOptions, time: ArrayLike | None,
) -> tuple[InertialDoppler, NDArray[np.int64]]:  # fmt: skip
    """Return the rows within the IMU data, and which observations were offered for them."""
    when = observations.time if time is None else np.asarray(time, dtype=float)
    inside = (when >= stream.start) & (when <= stream.end) & observations.has_range_rate
    if np.unique(when[inside]).size < 2:
        raise AlignmentError(
            "no Doppler with satellite states within the IMU data — do the times overlap, and "
            "are there navigation files?"
        )
    doppler = inertial_doppler(
        observations.take(inside), pos_e[inside] if pos_e.ndim == 2 else pos_e, options.noise,
        time=when[inside], interval=options.interval,
    )  # fmt: skip
    return doppler, np.flatnonzero(inside)


def _judged(found: InertialAlignment, time: float, options: MotionOptions) -> Attempt:
    sigma, limit = np.degrees([found.sigma_heading, options.sigma_heading])
    if found.passed and sigma > limit:
        message = (
            f"not aligned: heading ±{sigma:.2g}° 1σ (limit {limit:.2g}°), needs a turn, a change "
            "of speed or a standstill"
        )
        return Attempt(time, False, message, found)
    message = found.initial_attitude().message if found.passed else found.message
    return Attempt(time, found.passed, message, found)


def _with_bias(options: InertialOptions, mean: FloatArray, sigma: float) -> InertialOptions:
    return replace(options, gyro_bias=mean, gyro_bias_sigma=sigma)


def _still(doppler: InertialDoppler) -> NDArray[np.bool_]:
    """Return the epochs at which three or more satellites see no velocity.

    At rest z is the clock's drift for all satellites, whatever their directions.
    """
    z = doppler.z - np.sum(doppler.e_e * (doppler.pos_e @ OMEGA_IE_SKEW.T)[doppler.epoch], axis=1)
    still = np.zeros(doppler.time.size, dtype=bool)
    starts = np.searchsorted(doppler.epoch, np.arange(doppler.time.size + 1))
    for k in range(doppler.time.size):
        rows = slice(starts[k], starts[k + 1])
        if starts[k + 1] - starts[k] >= 3:
            off = np.abs(z[rows] - np.median(z[rows])) / doppler.sigma[rows]
            still[k] = bool(np.median(off) < 1.0 and off.max() < _STILL)
    return still


def _at_rest(
    stream: InertialStream, when: FloatArray, still: NDArray[np.bool_], last: int, imu: ImuSpec,
    shortest: float,
) -> tuple[FloatArray, float] | None:  # fmt: skip
    """Return the gyro bias of the last standstill before epoch `last`, with its σ.

    What the gyros show then is the bias and the Earth's rate, whose direction is not known yet.
    """
    k = last
    while k >= 0:
        if not still[k]:
            k -= 1
            continue
        j = k
        while j > 0 and still[j - 1]:
            j -= 1
        if when[k] - when[j] >= shortest:
            samples = slice(*np.searchsorted(stream.edges, [when[j], when[k]]))
            gyro = stream.gyro[samples]
            dt = float(np.median(np.diff(stream.edges)))
            limit = 3.0 * imu.gyro_noise_density / np.sqrt(dt) + _IDLE_GYRO
            if len(gyro) > 10 and np.all(gyro.std(axis=0) < limit):
                noise = imu.gyro_noise_density / np.sqrt(when[k] - when[j])
                sigma = np.sqrt(noise**2 + imu.gyro_bias_sigma**2 + EARTH_RATE**2)
                return gyro.mean(axis=0), float(sigma)
        k = j - 1
    return None
