"""What tests of the engine stand on: a filter at rest, a sky above it, a drive through a city.

All three are exact where they are not told to be wrong, so that what comes out can be computed
by hand.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from certnav.datasets.observations import GnssFixes, GnssObservations
from certnav.datasets.sequence import Calibration, Sequence
from certnav.datasets.series import ImuData
from certnav.datasets.simulation.canyon import City
from certnav.datasets.simulation.constellation import write_navigation
from certnav.datasets.simulation.signals import WAVELENGTH, ReceiverClock, SignalTruth, observe
from certnav.datasets.simulation.simulator import (
    Simulation,
    SimulationConfig,
    sample_times,
    simulate,
)
from certnav.filters import measurements
from certnav.filters.earth import OMEGA_IE_E, C_en_of, gravity_e
from certnav.filters.ekf import ErrorStateFilter
from certnav.filters.error_model import ACCEL_BIAS, GYRO_BIAS, ErrorModel
from certnav.filters.levers import AntennaPoint
from certnav.filters.measurements import Measurement
from certnav.filters.rotation import FloatArray, matrix_from_rpy
from certnav.filters.sensors import imu_preset
from certnav.filters.strapdown import InertialStream, NavState
from certnav.nav.engine.events import SHARED
from certnav.velocity.range_rate import predicted_range_rate

#: Where it all stands [m], and its axes north, east, down.
PLACE = np.array([-2267e3, 5009e3, 3221e3])
C_EN = C_en_of(PLACE)
IMU = imu_preset("adis16470")
#: Drift of the receiver's clock [m/s].
DRIFT = 12.0
#: As RTKLIB would give it: two metres horizontally, three vertically [m²].
FIX_COV = np.diag([4.0, 4.0, 9.0])
NAMES = ("G01", "G02", "G03", "G04", "G05", "G06", "G07", "G08")


def calibration(
    lever: ArrayLike = (0.0, 0.0, 0.0), sigma: float = 0.0, mounted: str = "", **more: object
) -> Calibration:
    """Return a calibration with the adis16470."""
    return Calibration(
        IMU, np.asarray(lever, dtype=float), "test", sigma, mounting_source=mounted, **more
    )


def range_rates(
    state: NavState, states: int, e_e: ArrayLike, z: ArrayLike, sigma: ArrayLike,
    lever_b: ArrayLike | AntennaPoint, omega_b: ArrayLike, *more: Any, **named: Any,
) -> Measurement:  # fmt: skip
    """Return the range rates of an epoch for a state, its antenna and its rate."""
    antenna = measurements.velocity(state, states, np.zeros(3), np.eye(3), lever_b, omega_b)
    return measurements.range_rates(antenna, e_e, z, sigma, *more, **named)


def stream_at_rest(C_eb: FloatArray, duration: float, start: float = 0.0) -> InertialStream:
    """Return what a perfect IMU measures that stands at `PLACE`, at 100 Hz."""
    count = round(duration * 100.0)
    edges = start + np.arange(count + 1) / 100.0
    gyro, accel = C_eb.T @ OMEGA_IE_E, -C_eb.T @ gravity_e(PLACE)
    return InertialStream.of_edges(edges, np.tile(gyro, (count, 1)), np.tile(accel, (count, 1)))


def filter_at_rest(
    duration: float = 2.0,
    *,
    heading: float = 0.0,
    sigma: tuple[float, float, float] = (1.0, 0.05, 1e-3),
    speed: float = 0.0,
    stream: InertialStream | None = None,
    **model: object,
) -> ErrorStateFilter:
    """Return a filter at `PLACE`, level, at the beginning of its data; it knows its biases.

    Parameters
    ----------
    duration : float
        [s].
    heading : float
        [rad].
    sigma : (float, float, float)
        1σ of position, velocity and attitude per axis [m], [m/s], [rad].
    speed : float
        Along the nose, as the filter has it [m/s].
    stream : InertialStream, optional
        In place of a standstill.
    model
        Of `ErrorModel`.
    """
    C_eb = C_EN @ matrix_from_rpy([0.0, 0.0, heading])
    made = ErrorModel(IMU, **model)
    stream = stream or stream_at_rest(C_eb, duration)
    pos, vel, att = (np.eye(3) * s**2 for s in sigma)
    P = made.initial_covariance(pos, vel, att, SHARED * pos)
    P[GYRO_BIAS, GYRO_BIAS], P[ACCEL_BIAS, ACCEL_BIAS] = np.eye(3) * 1e-12, np.eye(3) * 1e-8
    state = NavState(stream.start, PLACE.copy(), speed * C_eb[:, 0], C_eb)
    kalman = ErrorStateFilter(made, stream, state, P)
    if made.clock is not None:
        kalman.P[made.clock, made.clock] = 0.1**2
        kalman.gnss.clock_drift = DRIFT
    return kalman


def sky(
    names: tuple[str, ...] = NAMES,
    *,
    bias: dict[str, float] | None = None,
    vel_e: ArrayLike = (0.0, 0.0, 0.0),
    drift: float = DRIFT,
    time: float = 0.0,
    cn0: float | dict[str, float] = 45.0,
) -> GnssObservations:
    """Return one epoch of exact observations at `PLACE`.

    Parameters
    ----------
    names : tuple of str
        Of `NAMES`; each has its place in the sky.
    bias : dict
        Errors of range rates by satellite [m/s].
    vel_e : array_like, shape (3,)
        Of the antenna [m/s].
    drift : float
        Of the receiver's clock [m/s].
    time : float
        By the receiver's clock [s].
    cn0 : float or dict
        Of all, or by satellite with 45 for those not named [dB-Hz].
    """
    where = np.array([NAMES.index(name) for name in names], dtype=int)
    azimuth, elevation = where * 2.4, 0.35 + 0.9 * ((where * 0.618) % 1.0)
    e_n = np.column_stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth),
         -np.sin(elevation)]
    )  # fmt: skip
    e_e = e_n @ C_EN.T
    sat_pos_e = PLACE + 22e6 * e_e
    across = np.cross(e_e, [0.0, 0.0, 1.0])
    sat_vel_e = 3000.0 * across / np.linalg.norm(across, axis=1, keepdims=True)
    n = len(names)
    rate = predicted_range_rate(PLACE, vel_e, drift, sat_pos_e, sat_vel_e, np.zeros(n))
    rate = rate + [(bias or {}).get(name, 0.0) for name in names]
    power = cn0 if isinstance(cn0, dict) else dict.fromkeys(names, cn0)
    nan = np.full(n, np.nan)
    return GnssObservations(
        time=np.full(n, time), sat=np.array(names, dtype="U3"), signal=np.full(n, "1C"),
        wavelength=np.full(n, WAVELENGTH), pseudorange=np.full(n, 22e6), carrier=nan,
        range_rate=rate, cn0=np.array([power.get(name, 45.0) for name in names]),
        loss_of_lock=np.zeros(n, dtype=int), sat_pos_e=sat_pos_e, sat_vel_e=sat_vel_e,
        sat_clock=np.zeros(n), sat_clock_drift=np.zeros(n), elevation=nan, azimuth=nan,
        rejected=np.full(n, "", dtype="U24"),
    )  # fmt: skip


def positions(time: ArrayLike, pos_e: ArrayLike, quality: str = "single") -> GnssFixes:
    """Return positions without velocity, of `FIX_COV`, one each or one for all."""
    at = np.asarray(time, dtype=float)
    n = at.size
    return GnssFixes(
        at, np.broadcast_to(np.asarray(pos_e), (n, 3)), np.tile(FIX_COV, (n, 1, 1)),
        np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan), np.full(n, 8), np.full(n, quality),
    )  # fmt: skip


def recording(
    observations: GnssObservations | None = None,
    fixes: GnssFixes | None = None,
    navigation: tuple[str, ...] = ("nav",),
    **more: object,
) -> Sequence:
    """Return a recording of 100 s at rest with what GNSS has to offer."""
    rest = stream_at_rest(C_EN, 100.0)
    return Sequence(
        "made-up", ImuData(rest.edges[1:], rest.gyro, rest.accel), calibration(),
        observations=observations, fixes=fixes,
        navigation=navigation if observations is not None else (), **more,
    )  # fmt: skip


def joined(*epochs: GnssObservations) -> GnssObservations:
    """Return epochs one after the other."""
    return GnssObservations(
        **{
            f.name: np.concatenate([getattr(epoch, f.name) for epoch in epochs])
            for f in dataclasses.fields(GnssObservations)
        }
    )


class CityDrive(NamedTuple):
    """A drive between houses: what is known of it, and the truth."""

    sequence: Sequence
    simulation: Simulation
    signals: SignalTruth
    clock: ReceiverClock


def city_drive(folder: Path) -> CityDrive:
    """Return 100 s between houses, with reflections and a receiver's clock 50 ms ahead.

    Single-point positions and Doppler at 1 Hz, a lever arm of 1.7 m, 15 s of standstill first.

    Parameters
    ----------
    folder : Path
        For the navigation file.
    """
    config = SimulationConfig(
        seed=5, duration=100.0, density="urban", nlos_probability=0.8, static_start=15.0,
        lever_antenna_b=(-1.2, 0.4, -1.1),
    )  # fmt: skip
    made = simulate(config)
    second = np.arange(-2.0, config.duration + 3.0)
    clock = ReceiverClock(config.start_time, CubicSpline(second, 0.05 + 2e-8 * second))
    observations, signals = observe(
        made.trajectory, made.drive, City(config.density, config.seed, config.nlos_probability),
        made.ephemerides, clock, sample_times(config, config.gnss_rate),
        np.array(config.lever_antenna_b), np.random.default_rng(17),
    )  # fmt: skip
    made = dataclasses.replace(made, observations=observations, signals=signals, clock=clock)
    file = folder / "navigation.20n"
    write_navigation(file, made.ephemerides, config.start_time, config.start_time + config.duration)
    return CityDrive(made.sequence(navigation=(file,)), made, signals, clock)
