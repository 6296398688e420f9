"""Positions and velocities that come ready-made, offered to the filter."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...datasets.fix_faults import SAME, least_motion
from ...datasets.sequence import Calibration
from ...filters import measurements
from ...filters.ekf import ErrorStateFilter
from ...filters.measurement_update import Outcome
from ...filters.measurements import Measurement
from ...filters.rotation import FloatArray
from ..config import FilterConfig
from ..solution import Update
from .events import GnssEvent

#: What the log says of a measurement for whose sake the covariance was enlarged.
ENLARGED = "covariance enlarged after repeated refusal"


class FixUpdates:
    """Offers fixes; remembers which satellites the last position came from.

    Parameters
    ----------
    kalman : ErrorStateFilter
    calibration : Calibration
    config : FilterConfig
    """

    def __init__(
        self, kalman: ErrorStateFilter, calibration: Calibration, config: FilterConfig
    ) -> None:
        self.kalman, self.calibration, self.config = kalman, calibration, config
        self._satellites: set[str] = set()
        self._first: tuple[FloatArray, FloatArray] | None = None
        self._held_at = -np.inf

    def repeated(self, event: GnssEvent) -> bool:
        """Tell if a position repeats one from before the vehicle moved, or a velocity goes with it.

        What a recording can show is found before (`datasets.fix_faults`); this is for live data.
        """
        if event.kind != "position":
            return event.kind == "velocity" and event.time == self._held_at
        here_e = self.kalman.pos_e.copy()
        if self._first is None or np.abs(event.value_e - self._first[0]).max() > SAME:
            self._first = event.value_e, here_e
            return False
        moved = float(np.linalg.norm(here_e - self._first[1]))
        if moved <= least_motion(event.cov_e):
            return False
        self._held_at = event.time
        return True

    def overlap(self, satellites: tuple[str, ...]) -> float:
        """Return the share of satellites that a position has in common with the last one, 0 … 1."""
        before, now = self._satellites, set(satellites)
        self._satellites = now
        return len(before & now) / len(before | now) if before else 1.0

    def offer(self, event: GnssEvent, insist: bool) -> Update:
        """Offer a position or a velocity; with `insist`, enlarge the covariance until it fits."""
        measurement = self._position(event) if event.kind == "position" else self._velocity(event)
        outcome, reason = self._softly(measurement)
        if insist and not outcome.accepted:
            self.kalman.enlarge(measurement)
            if self.kalman.update(measurement, self.config.gate_probability).accepted:
                outcome, reason = dataclasses.replace(outcome, accepted=True), ENLARGED
        return logged(event.time, event.kind, event.satellites, outcome, reason)

    def _position(self, event: GnssEvent) -> Measurement:
        kalman, model = self.kalman, self.kalman.model
        antenna = kalman.antenna_point(self.calibration.lever_antenna_b)
        m = measurements.position(
            kalman.state, model.size, event.value_e, event.cov_e, antenna, kalman.omega_b
        )
        if event.ranges is not None:
            m = dataclasses.replace(m, biases=event.ranges)
        common_cov_e = event.common_cov_e
        if common_cov_e is None or model.fix_bias is None:
            return m
        overlap = self.overlap(event.satellites)
        if overlap < 1.0:
            kalman.reconsider(*kalman.gnss.other_satellites(kalman.P, overlap))
        return measurements.with_shared_error(m, common_cov_e, model.fix_bias, kalman.gnss.fix_bias)

    def _velocity(self, event: GnssEvent) -> Measurement:
        kalman = self.kalman
        antenna = kalman.antenna_point(self.calibration.lever_antenna_b)
        return measurements.velocity(
            kalman.state, kalman.model.size, event.value_e, event.cov_e, antenna, kalman.omega_b
        )

    def _softly(self, m: Measurement) -> tuple[Outcome, str]:
        """Offer a fix; one a little beyond the gate is weighted down to it, not refused."""
        kalman, gate = self.kalman, self.config.gate_probability
        outcome = kalman.update(m, gate)
        if outcome.accepted or not outcome.nis <= self.config.gate_width**2 * outcome.limit:
            return outcome, ""
        while not kalman.test(m, gate).accepted:
            m = dataclasses.replace(m, R=1.2 * m.R)
        kalman.update(m)
        reason = f"weighted down to the gate (NIS > {outcome.limit:.1f})"
        return dataclasses.replace(outcome, accepted=True), reason


def logged(
    time: float, kind: str, satellites: tuple[str, ...], outcome: Outcome, reason: str = ""
) -> Update:
    """Return what the log says of a measurement that was tested."""
    if not outcome.accepted and not reason:
        reason = f"innovation test (NIS > {outcome.limit:.1f})"
    whitened = tuple(outcome.whitened.tolist())
    return Update(time, kind, satellites, whitened, outcome.nis, outcome.accepted, reason)
