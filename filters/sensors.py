"""Inertial sensor specifications in datasheet units, with presets that name their source."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from .errors import ConfigError

#: Standard gravity [m/s²], the g of datasheets.
STANDARD_GRAVITY = 9.80665
_DEG = np.pi / 180.0
_DEG_PER_H = _DEG / 3600.0
_MG = 1e-3 * STANDARD_GRAVITY


@dataclass(frozen=True)
class ImuSpec:
    """One grade of IMU: noise, bias behaviour and turn-on spread, per axis, 1σ.

    Parameters
    ----------
    name, source : str
        What it is and where the numbers come from.
    gyro_arw_deg_sqrth : float
        Angular random walk [deg/√h].
    gyro_bias_instability_degph : float
        Steady-state σ of the bias in run [deg/h].
    gyro_bias_turn_on_degph : float
        σ of the bias at switch-on [deg/h]; the filter's initial σ.
    accel_vrw_mps_sqrth : float
        Velocity random walk [m/s/√h].
    accel_bias_instability_mg, accel_bias_turn_on_mg : float
        As for the gyro [mg].
    bias_correlation_time_s : float
        Time constant of the in-run bias as a first-order Gauss–Markov process;
        ``inf`` makes it a random walk that reaches the instability after one hour.
    gyro_scale_ppm, accel_scale_ppm : float
        σ of the scale factors [ppm]; used when the filter estimates them (21 states).

    Examples
    --------
    >>> from certnav.filters import ImuSpec
    >>> imu = ImuSpec("mine", "data sheet", 0.3, 10.0, 720.0, 0.1, 0.1, 10.0)
    >>> imu.gyro_bias_turn_on_degph, imu.accel_vrw_mps_sqrth, imu.bias_correlation_time_s
    (720.0, 0.1, 3600.0)
    """

    name: str
    source: str
    gyro_arw_deg_sqrth: float
    gyro_bias_instability_degph: float
    gyro_bias_turn_on_degph: float
    accel_vrw_mps_sqrth: float
    accel_bias_instability_mg: float
    accel_bias_turn_on_mg: float
    bias_correlation_time_s: float = 3600.0
    gyro_scale_ppm: float = 0.0
    accel_scale_ppm: float = 0.0

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, str) and not value >= 0.0:
                raise ConfigError(f"ImuSpec.{field.name}: expected a number ≥ 0, found {value!r}")
        if self.bias_correlation_time_s == 0.0:
            raise ConfigError("ImuSpec.bias_correlation_time_s: expected > 0 (inf: random walk)")

    @property
    def gyro_noise_density(self) -> float:
        """White rate noise [rad/s/√Hz]."""
        return self.gyro_arw_deg_sqrth * _DEG / 60.0

    @property
    def accel_noise_density(self) -> float:
        """White acceleration noise [m/s²/√Hz]."""
        return self.accel_vrw_mps_sqrth / 60.0

    @property
    def gyro_bias_sigma(self) -> float:
        """In-run bias σ [rad/s]."""
        return self.gyro_bias_instability_degph * _DEG_PER_H

    @property
    def accel_bias_sigma(self) -> float:
        """In-run bias σ [m/s²]."""
        return self.accel_bias_instability_mg * _MG

    @property
    def gyro_bias_initial_sigma(self) -> float:
        """Turn-on bias σ [rad/s]."""
        return self.gyro_bias_turn_on_degph * _DEG_PER_H

    @property
    def accel_bias_initial_sigma(self) -> float:
        """Turn-on bias σ [m/s²]."""
        return self.accel_bias_turn_on_mg * _MG

    def with_noise(self, gyro: float, accel: float, why: str) -> ImuSpec:
        """Return the IMU with more white noise [rad/s/√Hz], [m/s²/√Hz], and why."""
        return dataclasses.replace(
            self,
            source=f"{self.source}; {why}",
            gyro_arw_deg_sqrth=float(np.hypot(self.gyro_noise_density, gyro)) * 60.0 / _DEG,
            accel_vrw_mps_sqrth=float(np.hypot(self.accel_noise_density, accel)) * 60.0,
        )

    def bias_walk_density(self, sigma: float) -> float:
        """Return the driving noise [unit/√s] that keeps an in-run bias at `sigma`.

        Gauss–Markov: σ√(2/τ). Random walk (τ = ∞): σ reached after one hour.
        """
        if np.isinf(self.bias_correlation_time_s):
            return sigma / np.sqrt(3600.0)
        return sigma * np.sqrt(2.0 / self.bias_correlation_time_s)


#: Presets by name. Numbers marked "assumed" stand in no datasheet and are set wide.
PRESETS: dict[str, ImuSpec] = {
    "adis16470": ImuSpec(
        name="adis16470",
        source="GREAT-Dataset README (bias 8 deg/h, 13 mGal, ARW 0.34 deg/√h, VRW 0.037 m/s/√h); "
        "turn-on spread from biases GREAT-MSF estimates on campus-01/02 (≈500 deg/h, ≈10 mg); "
        "accelerometer in-run bias widened from 13 mGal to 0.1 mg for vibration (assumed)",
        gyro_arw_deg_sqrth=0.34,
        gyro_bias_instability_degph=8.0,
        gyro_bias_turn_on_degph=500.0,
        accel_vrw_mps_sqrth=0.037,
        accel_bias_instability_mg=0.1,
        accel_bias_turn_on_mg=10.0,
        gyro_scale_ppm=3000.0,
        accel_scale_ppm=3000.0,
    ),
    "tactical": ImuSpec(
        name="tactical",
        source="GREAT-Dataset README, StarNeto XW-GI7660 (≤0.5 deg/h, ≤100 mGal, 0.01 deg/√h); "
        "VRW not given there, 0.01 m/s/√h assumed",
        gyro_arw_deg_sqrth=0.01,
        gyro_bias_instability_degph=0.5,
        gyro_bias_turn_on_degph=1.0,
        accel_vrw_mps_sqrth=0.01,
        accel_bias_instability_mg=0.1,
        accel_bias_turn_on_mg=0.2,
        gyro_scale_ppm=100.0,
        accel_scale_ppm=100.0,
    ),
    "consumer": ImuSpec(
        name="consumer",
        source="assumed: a smartphone or breakout-board MEMS, set wide for vibration and "
        "uncalibrated scale factors",
        gyro_arw_deg_sqrth=0.6,
        gyro_bias_instability_degph=40.0,
        gyro_bias_turn_on_degph=1500.0,
        accel_vrw_mps_sqrth=0.2,
        accel_bias_instability_mg=1.0,
        accel_bias_turn_on_mg=30.0,
        bias_correlation_time_s=1000.0,
        gyro_scale_ppm=10000.0,
        accel_scale_ppm=10000.0,
    ),
}


def imu_preset(name: str) -> ImuSpec:
    """Return the preset `name`; an unknown name is a `ConfigError` with the nearest one.

    Examples
    --------
    >>> from certnav.filters import imu_preset
    >>> imu_preset("adis16470").gyro_arw_deg_sqrth
    0.34
    >>> imu_preset("adis")
    Traceback (most recent call last):
        ...
    certnav.filters.errors.ConfigError: IMU preset: unknown key 'adis' — did you mean 'adis16470'?
    """
    if name not in PRESETS:
        raise ConfigError.unknown_key(name, PRESETS, where="IMU preset")
    return PRESETS[name]
