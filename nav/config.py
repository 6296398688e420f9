"""Configuration of a run: frozen dataclasses, TOML in and out, unknown keys refused."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from ..filters.errors import ConfigError
from ..filters.sensors import PRESETS
from .vehicles import VEHICLES

#: Shortest window of certified alignment in motion [s].
SHORTEST_WINDOW = 5.0


def _choice(key: str, value: str, allowed: Iterable[str]) -> None:
    allowed = tuple(allowed)
    if value not in allowed:
        raise ConfigError(f"{key}: expected one of {', '.join(allowed)}; found '{value}'")


def _positive(key: str, value: float, zero: bool = False) -> None:
    if not (value >= 0.0 if zero else value > 0.0):
        raise ConfigError(f"{key}: expected a number {'≥' if zero else '>'} 0, found {value}")


def _within(key: str, value: float, least: float, below: float, said: str) -> None:
    if not least <= value < below:
        raise ConfigError(f"{key}: expected {said}, found {value:g}")


@dataclass(frozen=True)
class AlignmentConfig:
    """Initial attitude.

    Parameters
    ----------
    method : {'auto', 'certified', 'level+course', 'given'}
        'auto': 'given' when roll, pitch and heading are; else 'certified' if there is raw Doppler
        and a window passes within ``2 * max_window_s`` of its first, and 'level+course' if not.
        'certified': from IMU and Doppler alone, in motion, with a bound that is proved
        (`alignment.in_motion.waiting`).
        'level+course': levelling, at rest if there is a standstill and in motion otherwise, and the
        course of the GNSS velocity as heading.
    min_speed_mps : float
        Speed from which the course is taken as heading.
    roll_deg, pitch_deg, heading_deg : float, optional
        The given attitude, at the first epoch with a position and a velocity. A start after a
        solution was lost does not use it.
    sigma_level_deg, sigma_heading_deg : float
        1σ of a given attitude; lower bounds for a levelled one.
    sigma_clock_walk_mps : float
        Certified: random walk of the receiver's clock drift [m/s/√s].
    max_window_s : float
        Certified: longest window.
    max_sigma_heading_deg : float
        Certified: 1σ that the heading must have, beyond the verdicts.
    position_age_s : float
        Certified: how long before the window's end the latest position may be; ``inf`` takes any.
        From there on it is carried by the window's own motion, as well as that is known.
    """

    method: str = "auto"
    min_speed_mps: float = 3.0
    roll_deg: float | None = None
    pitch_deg: float | None = None
    heading_deg: float | None = None
    sigma_level_deg: float = 0.5
    sigma_heading_deg: float = 2.0
    sigma_clock_walk_mps: float = 0.1
    max_window_s: float = 60.0
    max_sigma_heading_deg: float = 1.5
    position_age_s: float = 60.0

    def __post_init__(self) -> None:
        _choice("alignment.method", self.method, ("auto", "certified", "level+course", "given"))
        for name in (
            "min_speed_mps", "sigma_level_deg", "sigma_heading_deg", "sigma_clock_walk_mps",
            "max_sigma_heading_deg", "position_age_s",
        ):  # fmt: skip
            _positive(f"alignment.{name}", getattr(self, name))
        said = f"at least {SHORTEST_WINDOW:g} s"
        _within("alignment.max_window_s", self.max_window_s, SHORTEST_WINDOW, float("inf"), said)
        angles = (self.roll_deg, self.pitch_deg, self.heading_deg)
        if self.method == "given" and None in angles:
            raise ConfigError(
                "alignment.method: 'given' needs alignment.roll_deg, pitch_deg and heading_deg"
            )


@dataclass(frozen=True)
class FilterConfig:
    """Error-state filter.

    Parameters
    ----------
    states : {15, 21}
        21 estimates scale factors too.
    bias_model : {'random-walk', 'gauss-markov'}
        See `filters.error_model`.
    imu : str
        IMU preset that replaces the one the sequence declares, by name or as a file (``*.toml``,
        as ``certnav allan`` writes it); '' keeps it.
    gate_probability : float
        Probability with which a correct measurement is refused; 0 switches the gates off.
    gate_width : float
        Positions and velocities whose innovation is up to so many times as large as the gate
        allows are weighted down until it is not, instead of being refused; 1: none.
    patience_s : float
        After refusals of one kind of update that have lasted so long, the covariance is doubted
        instead: it is enlarged, tenfold at most, and the update tried again. 0: never.
    smooth : bool
        Fixed-interval smoothing after the run: every epoch knows all data.
    output_rate_hz : float
        Rate of ``solution.csv``; 0 writes every IMU sample.
    protection_risk : float
        Probability with which the position may be off by more than its protection level,
        horizontally and vertically each, whichever one sensor is wrong; 0: no levels.
    """

    states: int = 15
    bias_model: str = "random-walk"
    imu: str = ""
    gate_probability: float = 1e-4
    gate_width: float = 2.0
    patience_s: float = 10.0
    smooth: bool = False
    output_rate_hz: float = 10.0
    # Of errors that last for some 30 s one in a hundred hours, the rarest that data can contradict.
    protection_risk: float = 1e-4

    def __post_init__(self) -> None:
        if self.states not in (15, 21):
            raise ConfigError(f"filter.states: expected 15 or 21, found {self.states}")
        _choice("filter.bias_model", self.bias_model, ("random-walk", "gauss-markov"))
        if self.imu and not self.imu.endswith(".toml") and self.imu not in PRESETS:
            raise ConfigError.unknown_key(self.imu, PRESETS, where="filter.imu")
        _within("filter.gate_probability", self.gate_probability, 0.0, 1.0, "0 ≤ p < 1")
        _within("filter.protection_risk", self.protection_risk, 0.0, 0.1, "0 ≤ p < 0.1")
        if not self.gate_width >= 1.0:
            raise ConfigError(f"filter.gate_width: expected ≥ 1, found {self.gate_width}")
        _positive("filter.patience_s", self.patience_s, zero=True)
        _positive("filter.output_rate_hz", self.output_rate_hz, zero=True)


@dataclass(frozen=True)
class GnssConfig:
    """What GNSS contributes, and what is screened out first.

    Parameters
    ----------
    position : {'auto', 'spp', 'rtk', 'carried', 'none'}
        Single-point positions or positions relative to a base station, both by RTKLIB, or
        positions the set carries; 'auto' takes the carried ones if there are any, else
        single-point ones.
    base : str
        RINEX observations of the base station, or a folder of them; '' takes what the recording
        has.
    base_position_e_m : list of three numbers
        ECEF position of the base's antenna; default: what its file says.
    systems : str
        Constellations used (G GPS, R GLONASS, E Galileo, J QZSS, C BeiDou); '': all there are.
    frequencies : int
        Bands of positions relative to a base, 1 to 3; 0: those that rover and base have.
    rtk_direction : {'forward', 'backward', 'combined'}
        Where ambiguities come from: the past, the future, or both, contradictions being float.
    velocity : {'auto', 'doppler', 'carried', 'none'}
        Least squares from Doppler, or velocities the set carries; 'auto' prefers Doppler.
    below_four : {'rows', 'ddia', 'off'}
        What Doppler does where least squares has no velocity but two satellites are usable: each
        satellite difference as a measurement, DDIA-VE's velocity, or nothing.
    forward_motion : {'auto', 'on', 'off'}
        Whether 'rows' of two or three satellites come with what DDIA-VE assumes, that the car
        goes where it points; 'auto': where the mounting is declared. Without effect where the
        vehicle's constraints say so anyway.
    ddia_min_k : float
        |SDV·RMD| below which DDIA-VE has no velocity.
    ddia_min_cn0_dbhz : float
        C/N0 that DDIA-VE asks of a satellite (the paper's screening).
    elevation_mask_deg : float
        Satellites below are not used.
    min_cn0_dbhz : float
        Signals weaker than this are not used.
    ionosphere : {'broadcast', 'off'}
        Correction of single-point positioning, by the model the satellites broadcast.
    troposphere : {'saastamoinen', 'off'}
        Correction of single-point positioning.
    raim : bool
        Fault detection and exclusion of single-point positioning.
    code_sigma_m : float
        Pseudorange noise at the zenith that single-point positioning assumes, multipath
        included; a street needs more than a roof.
    code_weak_sigma_m : float
        What reflections add to it at 45 dB-Hz; tenfold at 25 dB-Hz, no less above.
    doppler_sigma_mps, doppler_floor_mps : float
        Range-rate noise as declared: its thermal part at 45 dB-Hz, and what stays however strong
        the signal (`velocity.range_rate.DopplerNoise`).
    near_deg : list of two or three numbers
        Latitude and longitude, and height [m] if it is known, of where a recording without any
        position begins; Doppler and odometer find it more closely (`alignment.anywhere`).
    near_radius_km : float
        How far from there it may be.
    clock_walk_mps : float
        As declared: random walk of the receiver's clock drift, a state of the filter [m/s/√s]; 0:
        it is eliminated from every epoch instead. A receiver's quartz stays well below the default.
    doppler_hold_off_s : float
        How long a satellite whose Doppler disagreed with the filter is not believed.
    position_noise : {'fitted', 'declared'}
        How large the errors of positions are, and how much of them lasts: as fits the recording,
        found in a run before the run (`nav.engine.fix_noise`), or as declared. What is too short
        for a fit, or has no velocities, is taken as declared; so are live positions, and those
        with resolved ambiguities. A note says which, and why.
    velocity_noise : {'fitted', 'declared'}
        How large the errors of Doppler (by C/N0), of the receiver's clock and of velocities a set
        carries are: as fits the recording (`nav.engine.velocity_noise`), or as declared. What is
        too short for a fit is taken as declared; so is live data. A note says which.
    doppler_known_mps : list of four numbers
        Noise as `certnav tune` found it, σ and floor, and σ that its recordings show by themselves
        at 35 and 45 dB-Hz: in force instead of 'fitted' where a recording shows the same.
    position_correlation_s : float
        As declared: correlation time of the errors of single-point positions, which are then a
        state; 0: each position's error is its own. Positions a set carries are taken as such.
    delay_sigma_s : float
        1σ of a constant error of GNSS's time stamps against the IMU's, which is then estimated; 0:
        as the recording declares (``time_offset_sigma_s``), or none.
    position_sigma_scale, velocity_sigma_scale : float
        Factor on the standard deviations of positions and velocities.
    position_sigma_floor_m, velocity_sigma_floor_mps : float
        Lower bounds of those standard deviations, per axis.
    """

    position: str = "auto"
    base: str = ""
    base_position_e_m: tuple[float, ...] = ()
    systems: str = ""
    frequencies: int = 0
    rtk_direction: str = "forward"
    velocity: str = "auto"
    below_four: str = "rows"
    forward_motion: str = "auto"
    ddia_min_k: float = 0.2
    ddia_min_cn0_dbhz: float = 40.0
    elevation_mask_deg: float = 10.0
    min_cn0_dbhz: float = 35.0
    ionosphere: str = "broadcast"
    troposphere: str = "saastamoinen"
    raim: bool = True
    code_sigma_m: float = 1.0
    code_weak_sigma_m: float = 2.5
    doppler_sigma_mps: float = 0.06
    doppler_floor_mps: float = 0.04
    near_deg: tuple[float, ...] = ()
    near_radius_km: float = 100.0
    clock_walk_mps: float = 0.1
    doppler_hold_off_s: float = 1.5
    position_noise: str = "fitted"
    velocity_noise: str = "fitted"
    doppler_known_mps: tuple[float, ...] = ()
    position_correlation_s: float = 10.0
    delay_sigma_s: float = 0.0
    position_sigma_scale: float = 1.0
    velocity_sigma_scale: float = 1.0
    position_sigma_floor_m: float = 0.02
    velocity_sigma_floor_mps: float = 0.02

    def __post_init__(self) -> None:
        _choice("gnss.position", self.position, ("auto", "spp", "rtk", "carried", "none"))
        if "\0" in self.base:
            raise ConfigError(f"gnss.base: expected a path, found {self.base!r}")
        if len(base := self.base_position_e_m) not in (0, 3):
            raise ConfigError(f"gnss.base_position_e_m: expected X, Y, Z [m], found {[*base]}")
        if len(known := self.doppler_known_mps) not in (0, 4) or not all(v > 0.0 for v in known):
            raise ConfigError(f"gnss.doppler_known_mps: expected 4 numbers > 0, found {[*known]}")
        for letter in self.systems:
            _choice("gnss.systems", letter, tuple("GREJC"))
        _choice("gnss.frequencies", str(self.frequencies), ("0", "1", "2", "3"))
        _choice("gnss.rtk_direction", self.rtk_direction, ("forward", "backward", "combined"))
        most = (90.0, 360.0, 9000.0)[: len(self.near_deg)]
        beyond = any(not abs(v) <= m for v, m in zip(self.near_deg, most, strict=False))
        if len(self.near_deg) not in (0, 2, 3) or beyond:
            raise ConfigError(
                "gnss.near_deg: expected latitude and longitude in degrees, and a height in metres "
                f"if it is known, found {list(self.near_deg)}"
            )
        if not 0.0 < self.near_radius_km <= 5000.0:
            raise ConfigError(
                f"gnss.near_radius_km: expected up to 5000 km, found {self.near_radius_km:g}"
            )
        _choice("gnss.velocity", self.velocity, ("auto", "doppler", "carried", "none"))
        for name in ("position_noise", "velocity_noise"):
            _choice(f"gnss.{name}", getattr(self, name), ("fitted", "declared"))
        _choice("gnss.below_four", self.below_four, ("rows", "ddia", "off"))
        _choice("gnss.forward_motion", self.forward_motion, ("auto", "on", "off"))
        _choice("gnss.ionosphere", self.ionosphere, ("broadcast", "off"))
        _choice("gnss.troposphere", self.troposphere, ("saastamoinen", "off"))
        for name in (
            "code_sigma_m", "doppler_floor_mps", "position_sigma_scale", "velocity_sigma_scale",
        ):  # fmt: skip
            _positive(f"gnss.{name}", getattr(self, name))
        for name in (
            "position_sigma_floor_m", "velocity_sigma_floor_mps", "min_cn0_dbhz", "ddia_min_k",
            "ddia_min_cn0_dbhz", "doppler_sigma_mps", "clock_walk_mps", "doppler_hold_off_s",
            "position_correlation_s", "code_weak_sigma_m", "delay_sigma_s",
        ):  # fmt: skip
            _positive(f"gnss.{name}", getattr(self, name), zero=True)
        _within("gnss.elevation_mask_deg", self.elevation_mask_deg, -90.0, 90.0, "−90 … 90")


@dataclass(frozen=True)
class VehicleConfig:
    """What is known of the vehicle, whatever GNSS says.

    Parameters
    ----------
    kind : {'car', 'truck', 'bicycle', 'walker', 'robot', 'boat', 'aircraft'}
        Sets what is possible and which checks apply (`nav.vehicles`). What does not go where it
        points (walker, robot, boat, aircraft) has neither `nhc` nor ``gnss.forward_motion`` where
        these are 'auto'; in a configuration file boat and aircraft have no `zupt` and `zaru`, and
        ``alignment.min_speed_mps`` is the kind's, unless they are given.
    nhc : {'auto', 'on', 'off'}
        No sideways and no vertical velocity at the rear axle. 'auto': where the kind of vehicle
        goes where it points. How the IMU is turned in the vehicle and where the axle is are
        estimated unless they are declared as exact.
    sigma_lateral_mps, sigma_vertical_mps : float
        What tyres and springs allow all the same, of one constraint a second: more frequent ones
        get more, because it lasts for seconds.
    zupt, zaru : bool
        No velocity, no rotation while the IMU shows a standstill.
    sigma_zupt_mps : float
        How well a standstill is one.
    odometer : {'auto', 'on', 'off'}
        Forward speed with a scale factor as a state; how late it is against GNSS is measured first.
        'auto': where there is an odometer and the mounting is declared or estimated (`nhc`).
    sigma_odometer_mps : float
        Noise of the odometer's speed.
    interval_s : float
        Time between constraints.
    """

    kind: str = "car"
    nhc: str = "auto"
    # At the axle of road drives 0.03 … 0.04 m/s are left sideways, for 7 … 20 s: as white noise at
    # 1 Hz σ√(2τ) = 0.1 … 0.25. Upwards springs pitch the body by some 0.5° per m/s², at 15 m/s
    # 0.13 m/s for the 10 s that a car speeds up or brakes: 0.13 √20 = 0.6.
    sigma_lateral_mps: float = 0.3
    sigma_vertical_mps: float = 0.6
    zupt: bool = True
    zaru: bool = True
    sigma_zupt_mps: float = 0.05
    odometer: str = "off"
    sigma_odometer_mps: float = 0.2
    interval_s: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in VEHICLES:
            raise ConfigError.unknown_key(self.kind, VEHICLES, where="vehicle.kind")
        for name in ("nhc", "odometer"):
            _choice(f"vehicle.{name}", getattr(self, name), ("auto", "on", "off"))
        for name in (
            "sigma_lateral_mps", "sigma_vertical_mps", "sigma_zupt_mps", "sigma_odometer_mps",
            "interval_s",
        ):  # fmt: skip
            _positive(f"vehicle.{name}", getattr(self, name))


@dataclass(frozen=True)
class Config:
    """Everything in force during a run.

    Parameters
    ----------
    alignment, filter, gnss, vehicle
        See there.
    data : mapping
        Options of the reader, such as ``lever = "figure"``; the reader refuses unknown ones.

    Examples
    --------
    >>> from certnav.nav import Config
    >>> Config().gnss.min_cn0_dbhz, Config().filter.states
    (35.0, 15)
    """

    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)
    filter: FilterConfig = field(default_factory=FilterConfig)
    gnss: GnssConfig = field(default_factory=GnssConfig)
    vehicle: VehicleConfig = field(default_factory=VehicleConfig)
    data: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if VEHICLES[self.vehicle.kind].holds_course:
            return
        if self.vehicle.nhc == "auto":
            object.__setattr__(self, "vehicle", replace(self.vehicle, nhc="off"))
        if self.gnss.forward_motion == "auto":
            object.__setattr__(self, "gnss", replace(self.gnss, forward_motion="off"))
