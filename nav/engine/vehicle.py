"""Vehicle constraints in the loop: when they hold, and what is then offered to the filter."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...datasets.sequence import Calibration
from ...datasets.series import Odometer
from ...filters import constraints
from ...filters.ekf import ErrorStateFilter
from ...filters.error_model import GYRO_BIAS, VEL
from ...filters.measurements import Measurement
from ...filters.rotation import FloatArray
from ...filters.standstill import rate_at_rest
from ..config import VehicleConfig

#: A standstill is only believed where the filter's own speed allows it: a car that cruises on a
#: smooth road is as quiet as one that stands.
_SLOW, _KNOWN = 0.5, 1.0


class VehicleConstraints:
    """Offers what the vehicle cannot do, at regular times.

    Parameters
    ----------
    calibration : Calibration
    config : VehicleConfig
    odometer : Odometer, optional
    """

    def __init__(
        self, calibration: Calibration, config: VehicleConfig, odometer: Odometer | None = None
    ) -> None:
        self.config, self.calibration = config, calibration
        mounted = bool(calibration.mounting_source)
        self.nhc = config.nhc == "on" or (config.nhc == "auto" and mounted)
        wanted = config.odometer == "on" or (config.odometer == "auto" and mounted)
        self.odometer = odometer if wanted and odometer is not None else None

    def offered(
        self, kalman: ErrorStateFilter, credible: bool = True
    ) -> Iterator[tuple[str, Measurement]]:
        """Yield kind and measurement of what holds now; each is made when it is its turn.

        Parameters
        ----------
        kalman : ErrorStateFilter
        credible : bool
            Whether the filter's speed may be believed in telling a standstill.
        """
        config, n = self.config, kalman.model.size
        mean = self._standstill(kalman) if credible else None
        if mean is not None:
            if config.zupt:
                yield "zupt", constraints.zero_velocity(kalman.state, n, config.sigma_zupt_mps)
            if config.zaru:
                sigma = np.hypot(kalman.model.imu.gyro_noise_density, np.radians(0.005))
                yield (
                    "zaru",
                    constraints.zero_rate(kalman.state, n, mean, kalman.gyro_bias, float(sigma)),
                )
            return
        C_bv, lever = self.calibration.C_bv, self.calibration.lever_vehicle_b
        if self.nhc:
            sigma = (config.sigma_lateral_mps, config.sigma_vertical_mps)
            yield (
                "nhc",
                constraints.non_holonomic(kalman.state, n, kalman.omega_b, C_bv, lever, sigma),
            )
        speed = self._speed(kalman.time)
        if speed is not None and kalman.model.odometer:
            yield "odometer", constraints.odometer(
                kalman.state, n, kalman.omega_b, C_bv, lever, speed,
                config.sigma_odometer_mps, kalman.odometer_scale,
            )  # fmt: skip

    def _speed(self, time: float) -> float | None:
        odometer = self.odometer
        if odometer is None or not odometer.time[0] <= time <= odometer.time[-1]:
            return None
        return float(np.interp(time, odometer.time, odometer.speed))

    def _standstill(self, kalman: ErrorStateFilter) -> FloatArray | None:
        """Return the mean measured rate over the last second if the vehicle stood, else None."""
        if not (self.config.zupt or self.config.zaru):
            return None
        sigma = float(np.sqrt(np.diag(kalman.P)[VEL].max()))
        if sigma > _KNOWN or np.linalg.norm(kalman.vel_e) > max(_SLOW, 2.0 * sigma):
            return None
        sigma_bias = np.sqrt(np.diag(kalman.P)[GYRO_BIAS])
        return rate_at_rest(
            kalman.stream, kalman.time, kalman.model.imu, kalman.gyro_bias, sigma_bias
        )
