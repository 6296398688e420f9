"""Which errors a run estimates: the IMU's, and of GNSS those that its measurements can show."""

from __future__ import annotations

from ...datasets.sequence import Calibration
from ...filters.error_model import ErrorModel
from ...filters.sensors import ImuSpec, imu_preset
from ..config import Config, FilterConfig


def imu_spec(calibration: Calibration, config: FilterConfig) -> ImuSpec:
    """Return the IMU that is configured, else the one the recording declares."""
    return imu_preset(config.imu) if config.imu else calibration.imu


def error_model(
    calibration: Calibration,
    config: Config,
    *,
    odometer: bool = False,
    doppler: bool = True,
    shared: bool = True,
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
    """
    return ErrorModel(
        imu_spec(calibration, config.filter),
        states=config.filter.states,
        bias_model=config.filter.bias_model,
        odometer=odometer,
        clock_walk=config.gnss.clock_walk_mps if doppler else 0.0,
        fix_correlation=config.gnss.position_correlation_s if shared else 0.0,
    )
