"""Which errors a run estimates: the IMU's, and of GNSS those that its measurements can show."""

from __future__ import annotations

import numpy as np

from ...datasets.allan import read_preset
from ...datasets.sequence import Calibration
from ...filters.error_model import ErrorModel
from ...filters.levers import AntennaPrior, VehiclePrior
from ...filters.sensors import ImuSpec, imu_preset
from ..config import Config, FilterConfig

#: What is known where nothing is declared. Square by eye: 5° out of it is seen, 15° never done.
#: A rear axle is within 4 m (2σ) of any IMU in a car.
UNKNOWN = VehiclePrior(sigma_mounting=float(np.radians(5.0)), sigma_wheel=2.0)


def imu_spec(calibration: Calibration, config: FilterConfig) -> ImuSpec:
    """Return the IMU that is configured, else the one the recording declares."""
    if config.imu.endswith(".toml"):
        return read_preset(config.imu)
    return imu_preset(config.imu) if config.imu else calibration.imu


def error_model(
    calibration: Calibration,
    config: Config,
    *,
    odometer: bool = False,
    doppler: bool = True,
    shared: bool = True,
    nhc: bool = False,
) -> ErrorModel:
    """Return the error model of a run.

    A state that no measurement sees changes nothing but the time it takes.

    Parameters
    ----------
    calibration : Calibration
    config : Config
    odometer : bool
        Whether speeds of an odometer will be offered.
    doppler : bool
        Whether range rates will, which see the receiver's clock drift.
    shared : bool
        Whether positions will whose errors outlast an epoch.
    nhc : bool
        Whether the vehicle's constraint will, which sees mounting and wheel point.
    """
    return ErrorModel(
        imu_spec(calibration, config.filter),
        states=config.filter.states,
        bias_model=config.filter.bias_model,
        odometer=odometer,
        clock_walk=config.gnss.clock_walk_mps if doppler else 0.0,
        fix_correlation=config.gnss.position_correlation_s if shared else 0.0,
        vehicle=vehicle_prior(calibration) if nhc else VehiclePrior(),
        gnss_antenna=AntennaPrior(
            calibration.lever_antenna_sigma, config.gnss.delay_sigma_s or calibration.delay_sigma
        ),
    )


def vehicle_prior(calibration: Calibration) -> VehiclePrior:
    """Return how well mounting and wheel point are known before the data."""
    if not calibration.mounting_source:
        return UNKNOWN
    return VehiclePrior(calibration.mounting_sigma, calibration.lever_vehicle_sigma)
