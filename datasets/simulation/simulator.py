"""A seeded car in a seeded city under a seeded sky: sequences whose truth is known exactly.

Everything follows from `SimulationConfig`: the same configuration gives the same numbers. Each
part draws from its own stream, so that changing the IMU, say, leaves route and sky as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from ...filters.errors import ConfigError
from ...filters.rotation import FloatArray, matrix_from_rpy
from ...filters.sensors import ImuSpec, imu_preset
from .. import gpstime
from ..observations import GnssFixes, GnssObservations
from ..sequence import Calibration, Sequence
from ..series import ImuData, Reference
from .base_station import BaseStation, base_position, simulate_base
from .canyon import DENSITIES, City
from .constellation import Ephemerides, draw_constellation, referred_to
from .sensors import imu_measurements
from .signals import ReceiverClock, SignalTruth, observe
from .streets import Drive, RouteConfig, drive
from .trajectory import Trajectory

#: From the MEMS IMU, forward-right-down [m]: antenna and tactical IMU as in the installation
#: drawing of the GREAT dataset (2024-11-19).
LEVER_ANTENNA = (-0.65, -0.05, -0.15)
LEVER_TACTICAL = (-0.32, 0.0, 0.01)


@dataclass(frozen=True)
class SimulationConfig:
    """What to simulate.

    Parameters
    ----------
    name : str
        Of the sequence.
    seed : int
    duration : float
        [s].
    start : datetime
        GPS time of the beginning, on a whole second.
    origin_deg : (float, float, float)
        Latitude [deg], longitude [deg], ellipsoidal height [m] of the beginning.
    density : {'open', 'suburb', 'urban', 'canyon'}
        Buildings along the streets.
    nlos_probability : float
        That a blocked satellite is received by reflection.
    imu : str
        Preset of `filters.sensors`.
    imu_rate, gnss_rate, reference_rate : float
        [Hz].
    noise : bool
        False: exact inertial data and exact observations, no reflections, constant clock drift.
    scale_factors : bool
        Whether the IMU has scale-factor errors of its preset's σ.
    atmosphere, receiver_clock : bool
        Whether signals are delayed, and whether the receiver's clock is off.
    static_start : float
        Standstill at the beginning [s].
    moving_start : bool
        Begin at cruising speed instead.
    lever_antenna_b : (float, float, float)
        IMU to antenna, body axes [m].
    lever_imu_v : (float, float, float)
        Middle of the rear axle to IMU, vehicle axes [m].
    mounting_rpy_deg : (float, float, float)
        Roll, pitch, heading of the IMU in the vehicle [deg].
    base_distance_m : float, optional
        A base station stands so far from the beginning [m]; default: there is none.
    sky_seed : int, optional
        Of the satellites, which drives of one day with the same seed have in common; default: each
        drive has its own.

    Examples
    --------
    >>> from certnav.datasets import SimulationConfig
    >>> SimulationConfig(density="canyon", seed=3).imu_rate
    100.0
    >>> SimulationConfig(duration=1.0)
    Traceback (most recent call last):
        ...
    certnav.filters.errors.ConfigError: duration: expected at least 10 s, found 1
    """

    name: str = "simulated"
    seed: int = 0
    duration: float = 600.0
    start: datetime = datetime(2020, 10, 27, 2, 10)
    origin_deg: tuple[float, float, float] = (30.53, 114.36, 30.0)
    density: str = "urban"
    nlos_probability: float = 0.3
    imu: str = "adis16470"
    imu_rate: float = 100.0
    gnss_rate: float = 1.0
    reference_rate: float = 10.0
    noise: bool = True
    scale_factors: bool = False
    atmosphere: bool = True
    receiver_clock: bool = True
    static_start: float = 30.0
    moving_start: bool = False
    lever_antenna_b: tuple[float, float, float] = LEVER_ANTENNA
    lever_imu_v: tuple[float, float, float] = (0.5, 0.0, -1.4)
    mounting_rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    base_distance_m: float | None = None
    sky_seed: int | None = None

    def __post_init__(self) -> None:
        for key in ("duration", "imu_rate", "gnss_rate", "reference_rate"):
            if not getattr(self, key) > 0.0:
                raise ConfigError(f"{key}: expected a number > 0, found {getattr(self, key)!r}")
        if self.duration < 10.0:
            raise ConfigError(f"duration: expected at least 10 s, found {self.duration:g}")
        if not self.static_start >= 0.0:
            raise ConfigError(f"static_start: expected ≥ 0 s, found {self.static_start:g}")
        if not 0.0 <= self.nlos_probability <= 1.0:
            raise ConfigError(f"nlos_probability: expected 0…1, found {self.nlos_probability:g}")
        if self.base_distance_m is not None and not 0.0 <= self.base_distance_m <= 50e3:
            raise ConfigError(
                f"base_distance_m: expected 0 … 50000 m, found {self.base_distance_m:g}"
            )
        if self.start.tzinfo is not None or self.start.microsecond:
            raise ConfigError("start: expected GPS time without time zone, on a whole second")
        if self.density not in DENSITIES:
            raise ConfigError.unknown_key(self.density, DENSITIES, where="density")
        imu_preset(self.imu)

    @property
    def start_time(self) -> float:
        """GPS time of the beginning [s]."""
        s = self.start
        return gpstime.from_calendar(s.year, s.month, s.day, s.hour, s.minute, s.second)


@dataclass(frozen=True, eq=False)
class Simulation:
    """A simulated drive: what sensors and receiver report, and the truth behind it.

    Parameters
    ----------
    config : SimulationConfig
    trajectory : Trajectory
    drive : Drive
    imu : ImuData
    gyro_bias, accel_bias : ndarray, shape (n, 3)
        True biases at the IMU's times [rad/s], [m/s²].
    observations : GnssObservations
        With the satellite states of the simulator.
    signals : SignalTruth
        How each observation came about.
    ephemerides : Ephemerides
    clock : ReceiverClock
    reference : Reference
        The IMU's true motion.
    calibration : Calibration
    base : BaseStation, optional

    Examples
    --------
    >>> from certnav.datasets import SimulationConfig, simulate
    >>> drive = simulate(SimulationConfig(duration=10.0, density="open"))
    >>> drive.gyro_bias.shape == drive.imu.gyro_b.shape  # the truth behind what the sensor reports
    True
    >>> drive.sequence().reference.source
    'simulation truth'
    """

    config: SimulationConfig
    trajectory: Trajectory
    drive: Drive
    imu: ImuData
    gyro_bias: FloatArray
    accel_bias: FloatArray
    observations: GnssObservations
    signals: SignalTruth
    ephemerides: Ephemerides
    clock: ReceiverClock
    reference: Reference
    calibration: Calibration
    base: BaseStation | None = None

    def sequence(
        self, fixes: GnssFixes | None = None, navigation: tuple[Path, ...] = ()
    ) -> Sequence:
        """Return what an estimator may know, with the truth as reference.

        Parameters
        ----------
        fixes : GnssFixes, optional
            Positions, for example of `fixes_from_truth`.
        navigation : tuple of Path
            Navigation files, for single-point positioning.
        """
        return Sequence(
            name=self.config.name,
            imu=self.imu,
            calibration=self.calibration,
            observations=self.observations,
            navigation=navigation,
            fixes=fixes,
            reference=self.reference,
            notes=(f"simulated: {self.config}",),
        )

    def tactical_imu(self, rate: float = 200.0) -> ImuData:
        """Return what a tactical IMU beside the MEMS measures, in vehicle axes."""
        tr = self.trajectory
        lever_b = tr.C_bv @ np.array(LEVER_TACTICAL)
        imu, _, _ = imu_measurements(
            tr,
            sample_times(self.config, rate),
            imu_preset("tactical"),
            _stream(self.config, "tactical"),
            self.config.noise,
            lever_b=lever_b,
        )
        return ImuData(imu.time, imu.gyro_b @ tr.C_bv, imu.accel_b @ tr.C_bv)


_STREAMS = ("route", "sky", "clock", "signals", "imu", "tactical", "base")


def _stream(config: SimulationConfig, part: str) -> np.random.Generator:
    return np.random.default_rng([config.seed, _STREAMS.index(part)])


def sample_times(config: SimulationConfig, rate: float) -> FloatArray:
    """Return GPS times of samples from start to end [s], exact to 10 µs in seconds of week.

    What a file with five decimals holds then reads back as the very same numbers.
    """
    week, sow = gpstime.to_week_sow(config.start_time)
    count = int(np.floor(config.duration * rate + 1e-9)) + 1
    return gpstime.from_week_sow(int(week), np.round(float(sow) + np.arange(count) / rate, 5))


def simulate(config: SimulationConfig) -> Simulation:
    """Return the simulated drive of a configuration, in memory.

    Examples
    --------
    >>> from certnav.datasets import SimulationConfig, simulate
    >>> drive = simulate(SimulationConfig(duration=10.0, density="open", seed=1))
    >>> len(drive.imu), drive.reference.source
    (1001, 'simulation truth')
    """
    start = config.start_time
    route = RouteConfig(
        duration=config.duration,
        static_start=config.static_start,
        moving_start=config.moving_start,
    )
    motion = drive(route, _stream(config, "route"))
    lat, lon, height = config.origin_deg
    C_bv = matrix_from_rpy(np.radians(config.mounting_rpy_deg)).T
    trajectory = Trajectory(
        start,
        motion.time,
        motion.pos_t,
        motion.rpy,
        (np.radians(lat), np.radians(lon), height),
        config.lever_imu_v,
        C_bv,
    )
    spec = imu_preset(config.imu)
    imu, gyro_bias, accel_bias = imu_measurements(
        trajectory,
        sample_times(config, config.imu_rate),
        spec,
        _stream(config, "imu"),
        config.noise,
        scale_factors=config.scale_factors,
    )
    ephemerides = _sky(config)
    clock = ReceiverClock.perfect(start, config.duration)
    if config.receiver_clock:
        clock = ReceiverClock.draw(start, config.duration, _stream(config, "clock"), config.noise)
    lever_b = np.array(config.lever_antenna_b)
    observations, signals = observe(
        trajectory,
        motion,
        City(config.density, config.seed, config.nlos_probability),
        ephemerides,
        clock,
        sample_times(config, config.gnss_rate),
        lever_b,
        _stream(config, "signals"),
        noise=config.noise,
        atmosphere=config.atmosphere,
    )
    return Simulation(
        config=config,
        trajectory=trajectory,
        drive=motion,
        imu=imu,
        gyro_bias=gyro_bias,
        accel_bias=accel_bias,
        observations=observations,
        signals=signals,
        ephemerides=ephemerides,
        clock=clock,
        reference=trajectory.reference(sample_times(config, config.reference_rate)),
        calibration=_calibration(spec, lever_b, trajectory),
        base=_base(config, ephemerides),
    )


def _sky(config: SimulationConfig) -> Ephemerides:
    """Return the satellites, referred to the even hour nearest to the middle of the drive."""
    middle = config.start_time + 0.5 * config.duration
    if config.sky_seed is None:
        return draw_constellation(middle, _stream(config, "sky"))
    noon = (np.floor(config.start_time / 86400.0) + 0.5) * 86400.0
    rng = np.random.default_rng([config.sky_seed, _STREAMS.index("sky")])
    return referred_to(draw_constellation(float(noon), rng), middle)


def _base(config: SimulationConfig, ephemerides: Ephemerides) -> BaseStation | None:
    if config.base_distance_m is None:
        return None
    time = sample_times(config, config.gnss_rate)
    return simulate_base(
        base_position(config.origin_deg, config.base_distance_m),
        ephemerides,
        time,
        _stream(config, "base"),
        noise=config.noise,
        atmosphere=config.atmosphere,
        clock=None if config.receiver_clock else ReceiverClock.perfect(time[0], config.duration),
    )


def _calibration(spec: ImuSpec, lever_b: FloatArray, trajectory: Trajectory) -> Calibration:
    return Calibration(
        imu=spec,
        lever_antenna_b=lever_b,
        lever_antenna_source="simulation",
        C_bv=trajectory.C_bv,
        mounting_source="simulation truth",
        lever_vehicle_b=trajectory.lever_vehicle_b,
    )
