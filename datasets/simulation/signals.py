"""Simulated GPS L1 observations along a trajectory: exact paths, then noise.

Pseudorange and carrier phase are evaluated as what they are, the receiver clock's reading less
the transmission time on the satellite's clock, with the light-time equation solved in
coordinates that do not rotate during the flight. The Doppler is their numerical derivative by
receiver time. No range-rate formula enters, so an estimator's formula can be tested against it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from ...filters.earth import EARTH_RATE, SPEED_OF_LIGHT, C_en_of, ecef_to_lla
from ...filters.rotation import FloatArray
from .. import gpstime
from ..fields import StrArray
from ..observations import GnssObservations
from .atmosphere import klobuchar_delay, saastamoinen_delay
from .canyon import City, Sight
from .constellation import ION_ALPHA, ION_BETA, Ephemerides
from .streets import Drive
from .trajectory import Trajectory

#: GPS L1 wavelength [m].
WAVELENGTH = SPEED_OF_LIGHT / 1575.42e6
#: Half step of the numerical derivative [s]: truncation 7e-6 m/s at 10 m/s³, rounding 1e-6 m/s.
_HALF_STEP = 0.002
#: A receiver neither searches below this elevation [rad] nor tracks below this C/N0 [dB-Hz].
ELEVATION_MASK = np.radians(5.0)
TRACKING_THRESHOLD = 27.0


@dataclass(frozen=True, eq=False)
class ReceiverClock:
    """Clock offset of the receiver, smooth between seconds.

    Parameters
    ----------
    start : float
        GPS time from which the spline counts [s].
    spline : CubicSpline
        Offset [s]; positive when the receiver is ahead.
    """

    start: float
    spline: CubicSpline

    @classmethod
    def draw(
        cls, start: float, duration: float, rng: np.random.Generator, noise: bool
    ) -> ReceiverClock:
        """Return offset and drift as a two-state random walk from ±0.1 ms and ±3e-8.

        The drift walks by 1e-10/√s (0.03 m/s/√s), as a good oscillator's does; without noise
        it is constant.
        """
        second = np.arange(-2.0, duration + 3.0)
        drift = 3e-8 * rng.uniform(-1.0, 1.0) + np.zeros(second.size)
        if noise:
            drift[1:] += np.cumsum(1e-10 * rng.standard_normal(second.size - 1))
        bias = rng.uniform(-1e-4, 1e-4) + np.concatenate([[0.0], np.cumsum(drift[:-1])])
        return cls(start, CubicSpline(second, bias))

    @classmethod
    def perfect(cls, start: float, duration: float) -> ReceiverClock:
        """Return a clock that shows GPS time."""
        second = np.arange(-2.0, duration + 3.0)
        return cls(start, CubicSpline(second, np.zeros(second.size)))

    def bias(self, time: ArrayLike, offset: float = 0.0) -> FloatArray:
        """Return the offset [s] at receiver times, shape (n,)."""
        return np.asarray(self.spline((np.asarray(time, dtype=float) - self.start) + offset))

    def drift(self, time: ArrayLike) -> FloatArray:
        """Return the rate of the offset [s/s] at receiver times, shape (n,)."""
        return np.asarray(self.spline(np.asarray(time, dtype=float) - self.start, 1))


@dataclass(frozen=True, eq=False)
class SignalTruth:
    """How each row of the observations came about, shape (n,) each.

    Parameters
    ----------
    path : ndarray of str
        'direct', 'diffracted' (more than 6 dB lost at a roof edge) or 'reflected'.
    extra_range : ndarray
        Reflected path less direct path [m]; 0 unless reflected.
    extra_rate : ndarray
        Its rate [m/s].
    """

    path: StrArray
    extra_range: FloatArray
    extra_rate: FloatArray


def open_sky_cn0(elevation: FloatArray) -> FloatArray:
    """Return the C/N0 of an unobstructed signal [dB-Hz]: 38 at 5°, 45 at 30°, 51 at 90°."""
    return 34.0 + 17.0 * np.sin(np.maximum(elevation, 0.0)) ** 0.6


def pseudorange_sigma(cn0: FloatArray) -> FloatArray:
    """Return pseudorange noise [m]: 0.3 m at 50 dB-Hz, tenfold per 25 dB (3 m at 25)."""
    return 0.3 * 10.0 ** ((50.0 - cn0) / 25.0)


def range_rate_sigma(cn0: FloatArray) -> FloatArray:
    """Return Doppler noise [m/s]: σ² = 0.02² + (0.3·10^((25 − C/N0)/20))².

    A floor of oscillator and loop dynamics, and thermal noise, whose amplitude is inversely
    proportional to the signal's: 0.036 m/s at 45 dB-Hz, 0.10 at 35, 0.30 at 25.
    """
    return np.hypot(0.02, 0.3 * 10.0 ** ((25.0 - cn0) / 20.0))


class Motion(Protocol):
    """What a range asks of a trajectory: ECEF positions of a point on it."""

    def kinematics(
        self, time: ArrayLike, lever_b: ArrayLike = ..., offset: ArrayLike = ...
    ) -> Any: ...


@dataclass(frozen=True, eq=False)
class _Link:
    """Everything a range depends on, for n reception epochs and m satellites."""

    trajectory: Motion
    lever_b: FloatArray
    clock: ReceiverClock
    ephemerides: Ephemerides
    time: FloatArray
    atmosphere: bool

    def antenna_e(self, offset: float) -> FloatArray:
        """Return the antenna when the receiver's clock shows ``time + offset``, shape (n, 3)."""
        true_offset = offset - self.clock.bias(self.time, offset)
        return np.asarray(self.trajectory.kinematics(self.time, self.lever_b, true_offset).pos_e)

    def transmit(self, receiver_e: FloatArray, offset: float) -> tuple[FloatArray, ...]:
        """Solve the light-time equation for receivers of shape (n, m, 3) or (n, 1, 3).

        Returns the range [m], the transmission time after toe [s], the satellite in reception
        axes (n, m, 3) and its clock [s].
        """
        bias = self.clock.bias(self.time, offset)
        reception = ((self.time - self.ephemerides.toe) + offset - bias)[:, None]
        flight = np.full((self.time.size, len(self.ephemerides.sat)), 0.075)
        for _ in range(4):  # contracts by v/c = 1e-5 each time
            pos_e, clock = self.ephemerides.state(reception - flight)
            angle = EARTH_RATE * flight
            c, s = np.cos(angle), np.sin(angle)
            x, y = pos_e[..., 0], pos_e[..., 1]
            turned = np.stack([c * x + s * y, c * y - s * x, pos_e[..., 2]], axis=-1)
            distance = np.linalg.norm(turned - receiver_e, axis=-1)
            flight = distance / SPEED_OF_LIGHT
        return distance, reception - flight, turned, clock

    def angles(self, satellite_e: FloatArray, antenna_e: FloatArray) -> tuple[FloatArray, ...]:
        """Return azimuth and elevation [rad], shape (n, m) each."""
        sight = satellite_e - antenna_e[:, None]
        sight_n = np.einsum("nji,nmj->nmi", C_en_of(antenna_e), sight)
        azimuth = np.arctan2(sight_n[..., 1], sight_n[..., 0])
        return azimuth, np.arctan2(-sight_n[..., 2], np.hypot(sight_n[..., 0], sight_n[..., 1]))

    def measure(
        self, offset: float, mirror: tuple[FloatArray, FloatArray] | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return pseudorange and carrier range [m] at receiver time ``time + offset``, (n, m).

        `mirror` holds point and unit normal (ECEF) of the facade each signal is reflected at.
        """
        antenna_e = self.antenna_e(offset)
        receiver_e = antenna_e[:, None]
        if mirror is not None:
            point_e, normal_e = mirror
            depth = np.sum((receiver_e - point_e) * normal_e, axis=-1, keepdims=True)
            receiver_e = receiver_e - 2.0 * depth * normal_e
        distance, _, satellite_e, clock = self.transmit(receiver_e, offset)
        bias = self.clock.bias(self.time, offset)[:, None]
        base = distance + SPEED_OF_LIGHT * (bias - clock)
        ionosphere = np.zeros_like(base)
        if self.atmosphere:
            azimuth, elevation = self.angles(satellite_e, antenna_e)
            elevation = np.maximum(elevation, ELEVATION_MASK / 2)
            lla = np.broadcast_to(ecef_to_lla(antenna_e)[:, None], (*base.shape, 3))
            _, second = gpstime.to_week_sow(self.time)
            day = (second % 86400.0 + offset)[:, None]
            ionosphere = klobuchar_delay(ION_ALPHA, ION_BETA, day, lla, azimuth, elevation)
            base = base + saastamoinen_delay(lla, elevation)
        return base + ionosphere + SPEED_OF_LIGHT * self.ephemerides.tgd, base - ionosphere


def observe(
    trajectory: Trajectory,
    drive: Drive,
    city: City,
    ephemerides: Ephemerides,
    clock: ReceiverClock,
    time: FloatArray,
    lever_b: FloatArray,
    rng: np.random.Generator,
    *,
    noise: bool = True,
    atmosphere: bool = True,
) -> tuple[GnssObservations, SignalTruth]:
    """Return GPS L1 C/A observations and how they came about.

    Parameters
    ----------
    trajectory, drive : Trajectory, Drive
        The motion, and the blocks it passes.
    city : City
        The buildings.
    ephemerides : Ephemerides
    clock : ReceiverClock
    time : ndarray, shape (n,)
        Epochs by the receiver's clock, as GPS time [s].
    lever_b : ndarray, shape (3,)
        IMU to antenna, body axes [m].
    rng : numpy.random.Generator
    noise : bool
        False: exact observations, no reflections, no fluctuation of C/N0.
    atmosphere : bool
        Whether ionosphere and troposphere delay the signals.
    """
    link = _Link(trajectory, lever_b, clock, ephemerides, time, atmosphere)
    antenna_e = link.antenna_e(0.0)
    _, _, satellite_e, _ = link.transmit(antenna_e[:, None], 0.0)
    azimuth, elevation = link.angles(satellite_e, antenna_e)
    antenna_t = (antenna_e - trajectory.origin_e) @ trajectory.C_et
    index = drive.block_at(time - clock.start)
    sight = city.sight(drive.blocks, index, antenna_t, azimuth, np.maximum(elevation, 0.0))
    # Facades are known in the trajectory's axes; signals travel in ECEF.
    walls = replace(
        sight,
        wall_point=trajectory.origin_e + sight.wall_point @ trajectory.C_et.T,
        wall_normal=sight.wall_normal @ trajectory.C_et.T,
    )
    return _receive(link, walls, rng, noise)


def observe_open_sky(
    motion: Motion,
    ephemerides: Ephemerides,
    clock: ReceiverClock,
    time: FloatArray,
    rng: np.random.Generator,
    *,
    noise: bool = True,
    atmosphere: bool = True,
) -> GnssObservations:
    """Return GPS L1 C/A observations with nothing in the way; parameters as in `observe`."""
    link = _Link(motion, np.zeros(3), clock, ephemerides, time, atmosphere)
    shape = (time.size, len(ephemerides.sat))
    nothing = np.zeros((*shape, 3))
    free = Sight(np.zeros(shape), np.zeros(shape, bool), np.zeros(shape), nothing, nothing)
    return _receive(link, free, rng, noise)[0]


def _receive(
    link: _Link, sight: Sight, rng: np.random.Generator, noise: bool
) -> tuple[GnssObservations, SignalTruth]:
    """Return what a receiver makes of the signals; the walls of `sight` are in ECEF."""
    ephemerides, time = link.ephemerides, link.time
    antenna_e = link.antenna_e(0.0)
    _, sent, satellite_e, sat_clock = link.transmit(antenna_e[:, None], 0.0)
    azimuth, elevation = link.angles(satellite_e, antenna_e)
    cn0, reflected = _power(elevation, sight, rng, noise)
    tracked = (elevation > ELEVATION_MASK) & (cn0 >= TRACKING_THRESHOLD)

    direct = _differentiate(link.measure)
    values = direct
    if reflected.any():
        bounced = _differentiate(
            partial(link.measure, mirror=(sight.wall_point, sight.wall_normal))
        )
        values = tuple(np.where(reflected, b, d) for b, d in zip(bounced, direct, strict=True))
    extra = [v - d for v, d in zip(values, direct, strict=True)]
    pseudorange, carrier, rate = values
    carrier = carrier / WAVELENGTH
    if noise:
        pseudorange = pseudorange + pseudorange_sigma(cn0) * rng.standard_normal(cn0.shape)
        rate = rate + range_rate_sigma(cn0) * rng.standard_normal(cn0.shape)
        carrier = carrier + 0.01 * 10.0 ** ((45.0 - cn0) / 20.0) * rng.standard_normal(cn0.shape)
    fresh = _new_arcs(tracked, reflected)
    carrier = carrier + _ambiguities(fresh, rng)

    before, after = (ephemerides.state(sent + d) for d in (-0.5, 0.5))
    here, _ = ephemerides.state(sent)
    epoch, column = np.nonzero(tracked)
    pick = (epoch, column)
    count = epoch.size
    path = np.where(reflected, "reflected", np.where(sight.loss > 6.0, "diffracted", "direct"))
    observations = GnssObservations(
        time=time[epoch],
        sat=np.array(ephemerides.sat)[column],
        signal=np.full(count, "1C"),
        wavelength=np.full(count, WAVELENGTH),
        pseudorange=pseudorange[pick],
        carrier=carrier[pick],
        range_rate=rate[pick],
        cn0=cn0[pick],
        loss_of_lock=fresh[pick].astype(np.int64),
        sat_pos_e=here[pick],
        sat_vel_e=(after[0] - before[0])[pick],
        sat_clock=SPEED_OF_LIGHT * sat_clock[pick],
        sat_clock_drift=SPEED_OF_LIGHT * (after[1] - before[1])[pick],
        elevation=elevation[pick],
        azimuth=azimuth[pick] % (2.0 * np.pi),
        rejected=np.full(count, ""),
    )
    return observations, SignalTruth(path[pick], extra[0][pick], extra[2][pick])


def _differentiate(measure: Callable[[float], tuple]) -> tuple[FloatArray, ...]:
    """Return pseudorange, carrier range and the derivative of the latter by receiver time."""
    pseudorange, carrier = measure(0.0)
    rate = (measure(_HALF_STEP)[1] - measure(-_HALF_STEP)[1]) / (2.0 * _HALF_STEP)
    return pseudorange, carrier, rate


def _power(
    elevation: FloatArray, sight: Sight, rng: np.random.Generator, noise: bool
) -> tuple[FloatArray, np.ndarray]:
    """Return C/N0 [dB-Hz] of what is received, −inf for nothing, and where it is a reflection."""
    sky = open_sky_cn0(elevation)
    if noise:  # antenna and satellite power, then fading from epoch to epoch
        sky = sky + rng.normal(0.0, 1.0, sky.shape[1]) + rng.normal(0.0, 0.6, sky.shape)
    direct = sky - sight.loss
    echo = np.where(sight.reflected, sky - sight.reflection_loss, -np.inf)
    reflected = (direct < TRACKING_THRESHOLD) & (echo >= TRACKING_THRESHOLD) & noise
    # Receivers report quarter decibels at best.
    return np.round(4.0 * np.where(reflected, echo, direct)) / 4.0, reflected


def _new_arcs(tracked: np.ndarray, reflected: np.ndarray) -> np.ndarray:
    """Return where a phase-continuous arc begins: first epoch, reacquisition, other path."""
    before = np.vstack([np.zeros_like(tracked[:1]), tracked[:-1]])
    other = np.vstack([reflected[:1], reflected[:-1]]) != reflected
    return tracked & (~before | other)


def _ambiguities(fresh: np.ndarray, rng: np.random.Generator) -> FloatArray:
    """Return whole cycles, constant within each arc, shape (n, m)."""
    drawn = np.where(fresh, rng.integers(-1000000, 1000000, fresh.shape), 0)
    arc = np.maximum.accumulate(np.where(fresh, np.arange(len(fresh))[:, None], 0), axis=0)
    return np.take_along_axis(drawn, arc, axis=0).astype(float)
