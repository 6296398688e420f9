"""Doppler of an epoch offered to the filter: four satellites and more, or what is left of them.

Every satellite's range rate is a measurement of the antenna's velocity and of the receiver's clock
drift; four and more of them are a velocity, two or three are still equations, and nothing is
divided by k. 'ddia' is the paper's way below four: eq. (20) as a velocity along the vehicle's nose,
screened by C/N0 and |SDV·RMD|.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...datasets.sequence import Calibration
from ...filters import constraints, measurements
from ...filters.ekf import ErrorStateFilter
from ...filters.measurement_update import Outcome
from ...filters.measurements import Measurement
from ...velocity.ddia import ddia_velocity
from ...velocity.range_rate import DopplerRows, doppler_rows
from ..config import Config, GnssConfig
from ..solution import Update
from . import ddia_update
from .doppler_screening import DopplerScreening, antenna_motion
from .events import GnssEvent, doppler_noise
from .fix_update import logged

#: Doubted again within this time, the velocity is not all that is wrong [s].
_AGAIN = 60.0


class DopplerUpdates:
    """Offers the Doppler of epochs; remembers whom it did not believe, and how many there were.

    Parameters
    ----------
    kalman : ErrorStateFilter
    calibration : Calibration
    config : Config
    forward : bool
        Whether rows of two or three satellites come with the assumption that the car goes where
        it points.
    log : callable
        Takes what became of satellites left out, and of that assumption.

    Attributes
    ----------
    agreed : bool
        Whether a satellite of the last epoch agreed with the filter, clock and all: then it is
        not the filter that is to be doubted.
    below_four : bool
        Whether any epoch has come down to two or three satellites, or to four the first time: then
        what ``gnss.below_four`` says, and all that belongs to it, has mattered.
    """

    def __init__(
        self,
        kalman: ErrorStateFilter,
        calibration: Calibration,
        config: Config,
        forward: bool,
        log: Callable[[Update], None],
    ) -> None:
        self.kalman, self.calibration, self.config = kalman, calibration, config
        self.forward, self.log = forward, log
        self.agreed = self.below_four = False
        self._four = False
        self._doubted = -np.inf
        self._screening = DopplerScreening(
            config.gnss.doppler_hold_off_s, config.filter.gate_probability
        )

    def offer(self, event: GnssEvent, insist: bool, checked: bool) -> Update:
        """Offer what agrees with the filter, as a velocity or as rows.

        Parameters
        ----------
        event : GnssEvent
            With observations.
        insist : bool
            Doubt the filter first, and believe every satellite again.
        checked : bool
            Whether there are satellites enough for least squares to have checked them.
        """
        kalman, calibration, time = self.kalman, self.calibration, event.time
        assert event.observations is not None
        antenna_e = kalman.pos_e + kalman.C_eb @ calibration.lever_antenna_b  # a metre is nothing
        rows = doppler_rows(event.observations, antenna_e, doppler_noise(self.config.gnss))
        if insist:
            self._doubt(event, rows, checked)
        held = self._screening.held(rows, time)
        antenna = antenna_motion(kalman, calibration)
        keep = self._screening.test(kalman, calibration, rows, time, antenna)
        self._log_exclusion(time, rows.take(~keep & ~held))
        self.agreed = bool(keep.any()) and not checked
        count = int(keep.sum())
        enough = self._enough(count)
        self.below_four |= count >= 2 and not enough
        if count < 2 or (not enough and self.config.gnss.below_four == "off"):
            reason = f"fewer than {'two' if count < 2 else 'four'} satellites agree with the filter"
            if count == 4:
                reason = "four satellites, fewer the epoch before"
            return Update(time, event.kind, tuple(rows.sat.tolist()), reason=reason)
        return self._apply(time, rows.take(keep), enough, antenna)

    def _apply(self, time: float, rows: DopplerRows, enough: bool, antenna: Measurement) -> Update:
        kalman, calibration, config = self.kalman, self.calibration, self.config
        gate = config.filter.gate_probability
        kind = "velocity" if enough else "doppler"
        if not enough and config.gnss.below_four == "ddia":
            found, names, reason = apply_ddia(kalman, calibration, rows, time, config.gnss, gate)
            if found is None:
                return Update(time, kind, names, reason=reason)
            return logged(time, kind, names, found, reason)
        measurement = rows_measurement(kalman, calibration, rows, antenna)
        outcome = kalman.update(self._adapted(measurement), gate)
        if not enough and self.forward and outcome.accepted:
            straight = kalman.update(straight_ahead(kalman, calibration), gate)
            self.log(logged(time, "nhc", (), straight))
        return logged(time, kind, tuple(rows.sat.tolist()), outcome)

    def _doubt(self, event: GnssEvent, rows: DopplerRows, checked: bool) -> None:
        """Enlarge the covariance: of the velocity alone, if that is likely to be all."""
        self._screening.forget()
        usable = rows.take(np.isin(rows.sat, event.satellites))
        usable = replace(usable, z_by_pos=None)  # it is the velocity that they speak of
        m = rows_measurement(self.kalman, self.calibration, usable)
        if checked and event.time - self._doubted >= _AGAIN:
            self.kalman.doubt(m)
        else:
            self.kalman.enlarge(m)
        self._doubted = event.time

    def _adapted(self, m: Measurement) -> Measurement:
        """Return a measurement with R enlarged by what its NIS says R lacks."""
        nis = self.kalman.test(m, 0.0).nis
        return dataclasses.replace(m, R=m.R * max(1.0, nis / m.z.size))

    def _enough(self, satellites: int) -> bool:
        """Tell whether an epoch counts as four and more: four alone only the second time."""
        enough = satellites > 4 or (satellites == 4 and self._four)
        self._four = satellites >= 4
        return enough

    def _log_exclusion(self, time: float, rows: DopplerRows) -> None:
        if len(rows):
            names = tuple(rows.sat.tolist())
            hold = self.config.gnss.doppler_hold_off_s
            reason = f"disagrees with the filter: not believed for {hold:g} s"
            self.log(Update(time, "doppler", names, reason=reason))


def rows_measurement(
    kalman: ErrorStateFilter,
    calibration: Calibration,
    rows: DopplerRows,
    antenna: Measurement | None = None,
) -> Measurement:
    """Return the range rates of an epoch as one measurement; two rows or more without a clock.

    `antenna` is `antenna_motion` of the filter as it is, where that is known already.
    """
    antenna = antenna_motion(kalman, calibration) if antenna is None else antenna
    return measurements.range_rates(
        antenna, rows.e_e, rows.z, rows.sigma, kalman.model.clock, kalman.gnss.clock_drift,
        rows.z_by_pos, tuple(rows.sat.tolist()),
    )  # fmt: skip


def straight_ahead(kalman: ErrorStateFilter, calibration: Calibration) -> Measurement:
    """Return what DDIA-VE assumes as a measurement: the car goes where it points."""
    sigma = (ddia_update.SIGMA_CROSS, ddia_update.SIGMA_CROSS)
    point = kalman.vehicle.point(calibration.C_bv, calibration.lever_vehicle_b)
    return constraints.non_holonomic(kalman.state, kalman.model.size, kalman.omega_b, point, sigma)


def apply_ddia(
    kalman: ErrorStateFilter,
    calibration: Calibration,
    rows: DopplerRows,
    time: float,
    config: GnssConfig,
    gate_probability: float,
) -> tuple[Outcome | None, tuple[str, ...], str]:
    """Offer DDIA-VE's velocity; the outcome is None when there is none to offer."""
    # Rows carry σ, not C/N0; the noise model turns one threshold into the other.
    loud = rows.sigma <= float(doppler_noise(config).sigma(config.ddia_min_cn0_dbhz)) + 1e-12
    names = tuple(rows.sat.tolist())
    if loud.sum() < 2:
        return None, names, "fewer than two satellites above the C/N0 of DDIA-VE"
    motion = ddia_update.filter_motion(kalman, calibration)
    aided = ddia_velocity(rows.take(loud), motion, time, min_k=config.ddia_min_k)
    if not aided.ok:
        return None, names, aided.status
    measurement = ddia_update.measurement(
        kalman, aided, calibration,
        sigma_scale=config.velocity_sigma_scale, sigma_floor=config.velocity_sigma_floor_mps,
    )  # fmt: skip
    outcome = kalman.update(measurement, gate_probability)
    reason = "" if outcome.accepted else f"innovation test (NIS > {outcome.limit:.1f})"
    return outcome, aided.satellites, reason
