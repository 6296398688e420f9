"""Vehicle constraints in the loop: when they hold, and what is then offered to the filter."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from ...datasets.sequence import Calibration
from ...datasets.series import Odometer
from ...filters import constraints
from ...filters.ekf import ErrorStateFilter
from ...filters.error_model import GYRO_BIAS, VEL
from ...filters.measurements import Measurement
from ...filters.rotation import FloatArray
from ...filters.standstill import Rest, at_rest
from ...velocity.wheel_speed import WheelSpeed, wheel_speed
from ..config import VehicleConfig
from ..installation import AntennaPlace, Installation
from ..notes import Note
from ..vehicles import VEHICLES

#: Wear and pressure of tyres change the scale by less; the filter's own estimate begins with 2 %.
_TYRES = 0.06
#: A standstill is only believed where the filter's own speed allows it: a car that cruises on a
#: smooth road is as quiet as one that stands.
_SLOW, _KNOWN = 0.5, 1.0
#: Nor where the mean rate is no bias that the filter can believe in, for a car that cruises turns,
#: or where the mean force is no gravity that its level and biases allow: one that brakes evenly
#: is quiet, too. A standstill in a thousand not seen for a second is no loss.
_NO_BIAS = 1e-3
#: What a mean force at rest may be off by beside those, 1σ [m/s²]: scale factors, and a car that
#: sways on its springs.
_SWAYS = 0.1


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
        kind = VEHICLES[config.kind]
        self.off = ""
        if config.nhc == "off" or (config.nhc == "auto" and not kind.holds_course):
            self.off = "as configured (vehicle.nhc)"
            if not kind.holds_course:
                self.off = f"{kind.words} need not go where it points (vehicle.kind)"
        # Of what is not declared, estimates are at hand where the constraint makes them.
        known = bool(calibration.mounting_source) or self.nhc
        wanted = config.odometer == "on" or (config.odometer == "auto" and known)
        self.odometer = odometer if wanted and odometer is not None else None
        self.wheels: WheelSpeed | None = None

    def measure(self, time: FloatArray, speed: FloatArray) -> None:
        """Take out of the odometer's stamps, and a scale beyond tyres, what GNSS shows of them.

        Parameters
        ----------
        time, speed : ndarray, shape (m,)
            Of the vehicle, as GNSS has it [s], [m/s].
        """
        if self.odometer is None:
            return
        self.wheels = wheel_speed(self.odometer.time, self.odometer.speed, time, speed)
        if self.wheels is not None:
            scale = self.wheels.scale if self._other_unit else 1.0
            self.odometer = dataclasses.replace(
                self.odometer,
                time=self.odometer.time - self.wheels.delay,
                speed=self.odometer.speed * scale,
            )

    @property
    def _other_unit(self) -> bool:
        return self.wheels is not None and abs(self.wheels.scale - 1.0) > _TYRES

    @property
    def notes(self) -> tuple[Note, ...]:
        """What was found of the odometer, and is taken out."""
        found = self.wheels
        if found is None:
            return ()
        late = "late" if found.delay >= 0.0 else "early"
        text = (
            f"odometer: stamps {late} by {abs(found.delay):.3f} ± {found.delay_sigma:.3f} s "
            f"against GNSS velocities, taken out; speed is {found.scale:.4g} ± "
            f"{found.scale_sigma:.1g} times what it says"
        )
        if not self._other_unit:
            return (Note("note", f"{text}, estimated on"),)
        return (Note("doubtful", f"{text}, and is taken so: declare its unit"),)

    @property
    def nhc(self) -> bool:
        """Whether the vehicle goes where it points; if not, `off` says why."""
        return not self.off

    @property
    def sigma_nhc(self) -> tuple[float, float]:
        """1σ of one constraint, lateral and vertical [m/s].

        What a vehicle does all the same lasts for seconds. As white noise it has to be larger the
        more often it is asked: σ√(2τ/Δt).
        """
        often = max(1.0 / self.config.interval_s, 1.0) ** 0.5
        return self.config.sigma_lateral_mps * often, self.config.sigma_vertical_mps * often

    def installation(self, kalman: ErrorStateFilter) -> Installation:
        """Return mounting and wheel point as the filter knows them now."""
        calibration, model = self.calibration, kalman.model
        point = kalman.vehicle.point(calibration.C_bv, calibration.lever_vehicle_b)
        cov, sigma = np.zeros((2, 2)), np.zeros(2)
        if model.mounting is not None:
            cov = kalman.P[model.mounting, model.mounting].copy()
        if model.wheel is not None:
            sigma = np.sqrt(np.diag(kalman.P)[model.wheel])
        estimated = model.mounting is not None or model.wheel is not None
        source = "estimated" if estimated else calibration.mounting_source or "not declared"
        return Installation(
            self.off, source, point.C_bv, cov, point.C_bv.T @ point.lever_b, sigma,
            antenna_place(kalman, calibration),
        )  # fmt: skip

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
        rest = self._standstill(kalman) if credible else None
        if rest is not None:
            # Asked before either has taught the filter anything.
            if config.zupt and kalman.test(_no_rate(kalman, rest), _NO_BIAS).accepted:
                yield "zupt", constraints.zero_velocity(kalman.state, n, config.sigma_zupt_mps)
            if config.zaru:
                yield "zaru", _no_rate(kalman, rest)
            return
        point = kalman.vehicle.point(self.calibration.C_bv, self.calibration.lever_vehicle_b)
        if self.nhc:
            yield (
                "nhc",
                constraints.non_holonomic(kalman.state, n, kalman.omega_b, point, self.sigma_nhc),
            )
            # What that has taught of the mounting counts for the speed, too.
            point = kalman.vehicle.point(self.calibration.C_bv, self.calibration.lever_vehicle_b)
        speed = self._speed(kalman.time)
        if speed is not None and kalman.model.odometer:
            yield "odometer", constraints.odometer(
                kalman.state, n, kalman.omega_b, point, speed, config.sigma_odometer_mps,
                kalman.odometer_scale,
            )  # fmt: skip

    def _speed(self, time: float) -> float | None:
        odometer = self.odometer
        if odometer is None or not odometer.time[0] <= time <= odometer.time[-1]:
            return None
        return float(np.interp(time, odometer.time, odometer.speed))

    def _standstill(self, kalman: ErrorStateFilter) -> Rest | None:
        """Return what was measured over the last second if the vehicle stood, else None."""
        if not (self.config.zupt or self.config.zaru):
            return None
        sigma = float(np.sqrt(max(kalman.P.diagonal()[VEL].tolist())))
        speed = float(np.sqrt(kalman.vel_e @ kalman.vel_e))
        if sigma > _KNOWN or speed > max(_SLOW, 2.0 * sigma):
            return None
        sigma_bias = np.sqrt(np.diag(kalman.P)[GYRO_BIAS])
        rest = at_rest(kalman.stream, kalman.time, kalman.model.imu, kalman.gyro_bias, sigma_bias)
        if rest is None or not kalman.test(_no_acceleration(kalman, rest), _NO_BIAS).accepted:
            return None
        return rest


def _no_rate(kalman: ErrorStateFilter, rest: Rest) -> Measurement:
    """Return the mean rate of a second as a standstill's."""
    sigma = np.hypot(kalman.model.imu.gyro_noise_density, np.radians(0.005))
    return constraints.zero_rate(
        kalman.state, kalman.model.size, rest.rate_b, kalman.gyro_bias, float(sigma)
    )


def _no_acceleration(kalman: ErrorStateFilter, rest: Rest) -> Measurement:
    """Return the mean specific force of a second as a standstill's."""
    return constraints.zero_acceleration(
        kalman.state, kalman.model.size, rest.force_b, kalman.accel_bias, _SWAYS
    )


def antenna_place(kalman: ErrorStateFilter, calibration: Calibration) -> AntennaPlace:
    """Return where the antenna is, and how late its stamps are, as the filter knows it now."""
    model, sigma = kalman.model, np.sqrt(np.diag(kalman.P))
    prior = model.gnss_antenna
    return AntennaPlace(
        kalman.antenna.point(calibration.lever_antenna_b).lever_b,
        np.zeros(3) if model.antenna is None else sigma[model.antenna],
        np.full(3, prior.sigma_lever),
        kalman.antenna.delay_s,
        0.0 if model.delay is None else float(sigma[model.delay]),
        prior.sigma_delay,
    )
